"""The example rules and the example dashboard name what a real scrape has."""

import json
import re
import shutil
import subprocess
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import pytest
import yaml
from missing_parts import skip_without
from prometheus_client.parser import text_string_to_metric_families

FOLDER = Path(__file__).parents[2] / "examples" / "monitoring"
# Prometheus's own metric, and what its server adds to each sample.
FROM_ELSEWHERE = {"up": {"job": {"sawmill"}}}
TOKEN = re.compile(r'"[^"]*"|[A-Za-z_:][A-Za-z0-9_:]*|=~|!~|!=|==|[<>]=?|[0-9.]+[smhd]?|[^\s\w]')
# Words of PromQL that take a list of labels, and others that are no metric.
WITH_LABELS = {"by", "on", "without", "ignoring", "group_left", "group_right"}
OTHER_WORDS = {"or", "and", "unless", "sum", "max", "increase", "rate", "absent", "histogram_quantile"}

pytestmark = pytest.mark.usefixtures("seeded")


class Selector(NamedTuple):
    """A metric with the labels that it is asked for by, each with an operator and a value."""

    name: str
    matchers: list[tuple[str, str, str]]


def rules() -> list[dict]:
    groups = yaml.safe_load((FOLDER / "alerts.yml").read_text())["groups"]
    return [rule for group in groups for rule in group["rules"]]


def dashboard() -> dict:
    return json.loads((FOLDER / "dashboard.json").read_text())


def expressions() -> list[str]:
    targets = [target for panel in dashboard()["panels"] for target in panel.get("targets", [])]
    return [rule["expr"] for rule in rules()] + [target["expr"] for target in targets]


def parsed(expression: str) -> tuple[list[Selector], set[str]]:
    """The selectors of an expression, and the labels that it groups or joins by."""
    words = iter(TOKEN.findall(expression))
    selectors, grouped = [], set()
    for word in words:
        if word in WITH_LABELS:
            assert next(words) == "("
            grouped |= set(up_to(words, ")"))
        elif word == "{":
            asked = up_to(words, "}")
            selectors[-1].matchers.extend(
                zip(asked[::3], asked[1::3], (v.strip('"') for v in asked[2::3]), strict=True)
            )
        elif re.fullmatch(r"[a-z_:]\w*", word) and word not in OTHER_WORDS:
            selectors.append(Selector(word, []))
    return selectors, grouped


def up_to(words: Iterator[str], end: str) -> list[str]:
    return [word for word in iter(words.__next__, end) if word != ","]


@pytest.fixture
def known(client) -> dict[str, dict[str, set[str]]]:
    """Of a scrape of a service that has answered: the values of each label of each name."""
    client.get("/v1/scanners")
    found = defaultdict(lambda: defaultdict(set))
    for family in text_string_to_metric_families(client.get("/metrics").text):
        for sample in family.samples:
            values = found[sample.name]
            for label, value in sample.labels.items():
                values[label].add(value)
    return FROM_ELSEWHERE | found


def test_every_name_label_and_value_is_of_a_scrape_and_legends_name_labels_that_are_there(known):
    for expression in expressions():
        selectors, grouped = parsed(expression)
        assert selectors, expression
        for name, matchers in selectors:
            assert name in known, expression
            for label, _, value in matchers:
                assert label in known[name], expression
                if label != "status" and not value.startswith("$"):  # no request has failed here
                    assert set(value.split("|")) <= known[name][label], expression
        assert grouped <= {label for name, _ in selectors for label in known[name]}, expression
    for panel in dashboard()["panels"]:
        for target in panel.get("targets", []):
            selectors, grouped = parsed(target["expr"])
            left = grouped or {label for name, _ in selectors for label in known[name]}
            assert set(re.findall(r"\{\{(\w+)\}\}", target["legendFormat"])) <= left


def test_every_rule_says_how_grave_it_is_and_what_to_do(known):
    assert len({rule["alert"] for rule in rules()}) == len(rules())
    for rule in rules():
        assert rule["labels"]["severity"] in {"warning", "critical"}
        assert {"summary", "description"} == set(rule["annotations"])
        selectors, grouped = parsed(rule["expr"])
        left = grouped if "sum by" in rule["expr"] else {label for name, _ in selectors for label in known[name]}
        assert set(re.findall(r"\$labels\.(\w+)", str(rule["annotations"]))) <= left


def test_the_dashboard_is_one_that_grafana_reads():
    page = dashboard()
    panels = [panel for panel in page["panels"] if panel["type"] != "row"]
    assert page["title"] == "Sawmill calibration"
    assert page["schemaVersion"] >= 36
    assert len({panel["id"] for panel in page["panels"]}) == len(page["panels"])
    assert all(panel["targets"] and panel["datasource"]["uid"] == "${datasource}" for panel in panels)
    cells = [(x, y) for panel in page["panels"] for x, y in area(**panel["gridPos"])]
    assert len(cells) == len(set(cells)), "panels lie over each other"
    variables = {variable["name"] for variable in page["templating"]["list"]}
    assert set(re.findall(r"\$\{?([a-z]+)", json.dumps(panels))) <= variables


def area(x: int, y: int, w: int, h: int) -> Iterator[tuple[int, int]]:
    assert x + w <= 24
    return ((column, line) for column in range(x, x + w) for line in range(y, y + h))


@pytest.fixture
def promtool() -> str:
    return shutil.which("promtool") or skip_without("promtool, a part of Prometheus, is not installed")


def test_promtool_accepts_the_rules(promtool):
    checked = subprocess.run(
        [promtool, "check", "rules", str(FOLDER / "alerts.yml")], capture_output=True, text=True, check=False
    )
    assert checked.returncode == 0, checked.stderr


def test_promtool_accepts_a_scrape(client, promtool):
    text = client.get("/metrics").text
    checked = subprocess.run([promtool, "check", "metrics"], input=text, capture_output=True, text=True, check=False)
    # Its one complaint is about style: lengths are in millimetres, as everywhere in the product.
    assert [line for line in checked.stderr.splitlines() if 'use base unit "meters"' not in line] == []
    assert checked.returncode in {0, 3}
