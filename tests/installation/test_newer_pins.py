"""Newer pins: names keep their spelling, pins that nothing needs here stay, and the changes are listed."""

import tomllib

from newer_pins import PINS, ROOT, changes, needs_of, renewed, requirements

OLD = "Babel==2.18.0\nclick-plugins==1.1\nclick==8.5.1\ncolorama==0.4\npydantic_core==2.50.4\n"


def test_pins_are_renewed_in_place_and_new_packages_are_added():
    new = renewed(OLD, {"babel": "2.19.0", "Pydantic-Core": "2.50.5", "attrs": "26.1.0", "click": "8.5.1"})
    assert new == (
        "attrs==26.1.0\nBabel==2.19.0\nclick-plugins==1.1\nclick==8.5.1\ncolorama==0.4\npydantic_core==2.50.5\n"
    )
    assert changes(OLD, new) == ["attrs 26.1.0, new", "Babel 2.18.0 -> 2.19.0", "pydantic_core 2.50.4 -> 2.50.5"]
    assert changes(new, new) == []


def test_the_committed_pins_are_in_this_order():
    assert renewed(PINS.read_text(), {}) == PINS.read_text()


def test_all_requirements_but_the_product_s_own_are_resolved():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    wanted = requirements(project)
    assert {"numpy", "psycopg[binary]>=3.2", "pytest"} <= {text.split(";")[0].strip() for text in wanted}
    assert not [text for text in wanted if text.startswith(project["name"])]


def test_the_client_generator_is_resolved_without_typer():
    needed = ["attrs>=22.2.0", "typer<0.20,>0.16", "ruff>=0.2", 'pytest; extra == "dev"']
    assert needs_of({"metadata": {"requires_dist": needed}}) == ["attrs>=22.2.0", "ruff>=0.2"]
