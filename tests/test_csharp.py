"""The C# of docs/do/connect.md, which no compiler reads here: its grammar and its names."""

import json
import re
from collections.abc import Iterator
from pathlib import Path

import tree_sitter_c_sharp
from tree_sitter import Language, Node, Parser

ROOT = Path(__file__).parents[1]
BLOCKS = re.findall(r"```csharp\n(.*?)```", (ROOT / "docs/do/connect.md").read_text(), re.DOTALL)
DOCUMENT = json.loads((ROOT / "openapi/openapi.json").read_text())
SCHEMAS = DOCUMENT["components"]["schemas"]
# Records that the page calls otherwise than the contract does.
CALLED = {
    "Scanner": "StoredScanner",
    "Phantom": "StoredPhantom",
    "Calibration": "CalibrationSucceeded",
    "Page": "ScanPage",
    "RefusedValue": "FieldProblem",
}


def nodes(block: str) -> Iterator[Node]:
    def below(node: Node) -> Iterator[Node]:
        yield node
        for child in node.children:
            yield from below(child)

    return below(Parser(Language(tree_sitter_c_sharp.language())).parse(block.encode()).root_node)


def snake_case(name: str) -> str:
    """As JsonNamingPolicy.SnakeCaseLower writes it."""
    return re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", name).lower()


def text(node: Node | None) -> str:
    assert node is not None
    assert node.text is not None
    return node.text.decode()


def test_its_grammar_is_that_of_csharp():
    assert len(BLOCKS) > 10
    wrong = [(block[:60], node.start_point) for block in BLOCKS for node in nodes(block) if node.is_error]
    missing = [(block[:60], node.start_point) for block in BLOCKS for node in nodes(block) if node.is_missing]
    assert (wrong, missing) == ([], [])


def test_its_paths_are_the_contract_s():
    sent = {
        re.sub(r"\{[^}]*\}", "{}", path)
        for block in BLOCKS
        for path in re.findall(r'"(/v1/[^"?]*)', re.sub(r"\{Uri\.[^}]*\}", "", block))
    }
    patterns = [re.sub(r"\{[^}]*\}", "[^/]+", path) for path in DOCUMENT["paths"]]
    assert len(sent) > 10
    assert {path for path in sent if not any(re.fullmatch(pattern, path) for pattern in patterns)} == set()


def test_its_records_have_the_contract_s_names():
    records = [node for block in BLOCKS for node in nodes(block) if node.type == "record_declaration"]
    assert len(records) > 8
    unknown = []
    for record in records:
        name = text(record.child_by_field_name("name"))
        parameters = [node for node in record.children if node.type == "parameter_list"]
        fields = {snake_case(text(node.child_by_field_name("name"))) for node in parameters[0].named_children}
        unknown += [(name, field) for field in fields - set(SCHEMAS[CALLED.get(name, name)]["properties"])]
    assert unknown == []
