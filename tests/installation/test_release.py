"""What a release contains, which commits are refused, and newer pins. `make release` builds everything in minutes."""

import json
import os
import re
import subprocess
import tomllib
import zipfile
from email.parser import BytesParser
from importlib.metadata import metadata
from pathlib import Path

import bundle
import pytest
import release
import shipped
from bundle import digest
from newer_pins import PINS, changes, needs_of, renewed, requirements

ROOT = Path(__file__).parents[2]


@pytest.fixture
def commit(tmp_path: Path) -> Path:
    root = tmp_path / "repository"
    for name, text in {
        release.VERSION_FILE: 'VERSION = "1.2.3"\n',
        "CHANGELOG.md": "# Changelog\n\n## [1.2.3] - 2026-11-26\n",
        "openapi/released.json": '{"info": {"version": "1.2.3"}}',
    }.items():
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_text(text)
    git(root, "init")
    tagged(root, "A release")
    return root


def git(root: Path, *words: str) -> str:
    author = ["-c", "user.name=nobody", "-c", "user.email=nobody@mill.example"]
    return subprocess.run(["git", *author, *words], cwd=root, check=True, capture_output=True, text=True).stdout


def tagged(root: Path, subject: str) -> None:
    git(root, "add", ".")
    git(root, "commit", "--message", subject)
    git(root, "tag", "--force", "v1.2.3")


def test_a_commit_whose_tag_version_changelog_and_contract_agree_is_released(commit):
    release.check(commit, release.version_of(commit))


@pytest.mark.parametrize(
    ("file", "text", "fault"),
    [
        (release.VERSION_FILE, 'VERSION = "1.2.4"\n', r"has the tags \['v1\.2\.3'\], and must have v1\.2\.4"),
        ("CHANGELOG.md", "## [1.2.3] - unreleased\n", r"begins with '## \[1\.2\.3\] - unreleased': it must be 1\.2\.3"),
        ("openapi/released.json", '{"info": {"version": "1.2.2"}}', r"has version 1\.2\.2: make release-contract"),
        ("CHANGELOG.md", "", "files are changed or new and not committed"),
        ("service/new.py", "", "files are changed or new and not committed"),  # the image would have it
    ],
    ids=["version", "date", "contract", "changed", "new"],
)
def test_a_commit_that_is_no_release_is_refused_with_the_remedy(commit, file, text, fault):
    (commit / file).parent.mkdir(exist_ok=True)
    (commit / file).write_text(text)
    with pytest.raises(release.ReleaseError, match=fault):
        release.check(commit, release.version_of(commit))


def test_a_commit_whose_figures_are_older_than_their_code_is_no_release(commit):
    first = git(commit, "rev-parse", "HEAD")
    (results := commit / "benchmarks/results").mkdir(parents=True)
    file = {"commit": first.strip(), "measures": ["worker"], "command": "make bench"}
    (results / "speed.json").write_text(json.dumps(file))
    (commit / "worker/fit.py").touch()
    tagged(commit, "A fit")
    with pytest.raises(release.ReleaseError, match=r"^stale figures, speed: worker changed in .*: run make bench$"):
        release.check(commit, "1.2.3")


@pytest.fixture
def wheels(tmp_path: Path) -> list[Path]:
    of_a = {
        "a-1.0.dist-info/licenses/": "",
        "a-1.0.dist-info/licenses/COPYING.txt": "Do as you like.",
        "a-1.0.dist-info/licenses/LICENSE.external": "Others ask for more.",
        "a-1.0.data/data/share/doc/a/third-party-programs.txt": "Parts of C.",
        "a/licenses/names.py": "NAMES = ()",
    }
    texts = {"sawmill_calibration": {}, "a": of_a, "b": {}}
    made = [tmp_path / f"{name}-1.0-py3-none-any.whl" for name in texts]
    for wheel, (name, files) in zip(made, texts.items(), strict=True):
        about = f"Name: {name.replace('_', '-')}\nVersion: 1.0\nLicense-Expression: MIT\n\nabout it\n"
        with zipfile.ZipFile(wheel, "w") as packed:
            for path, text in {f"{name}-1.0.dist-info/METADATA": about, **files}.items():
                packed.writestr(zipfile.ZipInfo(path), text)
    return made


def test_the_bill_of_materials_names_each_package_and_depends_on_the_wheels_alone(wheels):
    digests = {wheel.name: digest(wheel) for wheel in wheels}
    texts = {shipped.bill_of_materials(wheels, digests, 1_700_000_000) for _ in range(2)}
    bill = json.loads(texts.pop())
    assert not texts
    about = (bill["bomFormat"], bill["specVersion"], bill["metadata"]["component"]["name"])
    assert about == ("CycloneDX", "1.6", "sawmill-calibration")
    component, _ = bill["components"]
    assert (component["purl"], component["licenses"]) == ("pkg:pypi/a@1.0", [{"license": {"name": "MIT"}}])
    assert component["hashes"] == [{"alg": "SHA-256", "content": digests["a-1.0-py3-none-any.whl"]}]


def test_the_licences_have_our_own_each_package_s_name_and_texts_and_those_of_files_inside_a_package(wheels, tmp_path):
    text = "".join(shipped.licences(wheels, "Apache License"))
    assert text.startswith("Sawmill calibration is licensed under Apache-2.0:\n\nApache License\n")
    assert re.search(r"\na 1\.0: MIT\n\n----- a-1\.0\.data/.*third-party-programs\.txt\n\nParts of C\.\n", text)
    assert "\n----- a-1.0.dist-info/licenses/COPYING.txt\n\nDo as you like.\n" in text
    assert "\n----- a-1.0.dist-info/licenses/LICENSE.external\n\nOthers ask for more.\n" in text
    assert len(re.findall(r"^-----", text, re.MULTILINE)) == 3, "no folders and no programs"
    assert "\nb 1.0: MIT\n\nIts wheel contains no text of the licence.\n" in text
    wheel = tmp_path / "fastapi_offline-1.0-py3-none-any.whl"
    with zipfile.ZipFile(wheel, "w") as packed:
        about = f"Name: {metadata('fastapi-offline')['Name']}\nVersion: 1.0\n"
        packed.writestr("fastapi_offline-1.0.dist-info/METADATA", about)
    assert "Swagger UI, Apache-2.0" in "".join(shipped.licences([wheel], ""))


def test_wheels_do_not_depend_on_the_mask_of_their_maker(tmp_path):
    """Nor on the newest setuptools: a registry is not asked."""
    made = []
    for mask in (0o022, 0o077):
        before = os.umask(mask)
        try:
            (generator := (source := tmp_path / f"{mask}") / "openapi/clients/generate.py").parent.mkdir(parents=True)
            generator.touch()
            project = '[project]\nname = "a"\nversion = "1"\n[tool.setuptools]\npy-modules = ["a"]\n'
            (source / "pyproject.toml").write_text(project)
            (source / "a.py").touch()
            bundle.make_wheels(source, source / "wheels", 1_700_000_000)
        finally:
            os.umask(before)
        made.append(digest(source / "wheels/a-1-py3-none-any.whl"))
    assert made[0] == made[1]


def test_an_archive_of_an_image_that_is_not_whole_has_no_archive_s_name(tmp_path):
    """buildah breaks off while it writes the archive; all programs but git are fakes."""
    (programs := tmp_path / "programs").mkdir()
    half = 'case "$*" in *push*) for last; do :; done; last=${last#*:}; echo half > "${last%%:*}"; exit 1;; esac'
    for name, text in {"docker": "exit 1", "id": "echo 0", "buildah": half}.items():
        (programs / name).write_text(f"#!/bin/sh\n{text}\n")
        (programs / name).chmod(0o755)
    environment = {"PATH": f"{programs}:{os.environ['PATH']}", "HOME": str(tmp_path)}
    script = ["sh", ROOT / "installation/image.sh", tmp_path / "dist"]
    assert subprocess.run(script, env=environment, check=False, capture_output=True).returncode == 1
    assert [path.suffix for path in (tmp_path / "dist").iterdir()] == [".part"]


@pytest.mark.parametrize(
    ("fields", "shown"),
    [
        ("License-Expression: MIT", "MIT"),
        ("Classifier: License :: OSI Approved :: BSD License", "BSD License"),
        ("License: a text\n        of many lines\nClassifier: License :: OSI Approved :: MIT License", "MIT License"),
        ("License: die übliche\n  in vielen Zeilen\nClassifier: License :: OSI Approved :: MIT License", "MIT License"),
        ("Author: nobody", "see the wheel"),
    ],
    ids=["expression", "classifier", "whole text", "not ASCII", "none"],
)
def test_a_package_s_licence_is_what_its_makers_state(fields, shown):
    assert shipped.licence(BytesParser().parsebytes(f"{fields}\n\n".encode())) == shown


OLD = "Babel==2.18.0\nclick-plugins==1.1\nclick==8.5.1\ncolorama==0.4\npydantic_core==2.50.4\n"


def test_pins_are_renewed_in_place_and_new_packages_are_added():
    new = renewed(OLD, {"babel": "2.19.0", "Pydantic-Core": "2.50.5", "attrs": "26.1.0", "click": "8.5.1"})
    assert new == (
        "attrs==26.1.0\nBabel==2.19.0\nclick-plugins==1.1\nclick==8.5.1\ncolorama==0.4\npydantic_core==2.50.5\n"
    )
    assert changes(OLD, new) == ["attrs 26.1.0, new", "Babel 2.18.0 -> 2.19.0", "pydantic_core 2.50.4 -> 2.50.5"]
    assert changes(new, new) == []
    assert renewed(PINS.read_text(), {}) == PINS.read_text(), "the committed ones are in this order"


def test_all_requirements_but_the_product_s_own_are_resolved():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    wanted = requirements(project)
    assert {"numpy>=2.2", "psycopg[binary]>=3.3.9", "pytest"} <= {text.split(";")[0].strip() for text in wanted}
    assert not [text for text in wanted if text.startswith(project["name"])]
    # The client's generator without typer.
    needed = ["attrs>=22.2.0", "typer<0.20,>0.16", "ruff>=0.2", 'pytest; extra == "dev"']
    assert needs_of({"metadata": {"requires_dist": needed}}) == ["attrs>=22.2.0", "ruff>=0.2"]
