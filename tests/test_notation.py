"""Every parameter and state variable states its unit where it is defined and in NOTATION.md."""

import ast
import re
from pathlib import Path

import pytest

from tracked_env.physics import parameters

ROOT = Path(__file__).resolve().parent.parent
PHYSICS = ROOT / "tracked_env" / "physics"
DOCUMENTED = {"parameters.py": ("PlantParameters", "VehicleState")}


def commented_units(file, class_name):
    """Unit in the comment `# [unit] ...` of each field of a class; None where there is none."""
    text = (PHYSICS / file).read_text(encoding="utf-8")
    lines = text.splitlines()
    (definition,) = (
        node
        for node in ast.parse(text).body
        if isinstance(node, ast.ClassDef) and node.name == class_name
    )
    units = {}
    for node in definition.body:
        if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            comment = re.search(r"#\s*\[([^\]]+)\]", lines[node.lineno - 1])
            units[node.target.id] = comment.group(1) if comment else None
    return units


def table_rows():
    """Cells of the tables of NOTATION.md, by the name in backticks in the first column."""
    rows = {}
    for line in (ROOT / "NOTATION.md").read_text(encoding="utf-8").splitlines():
        if line.startswith("| `"):
            cells = [cell.strip() for cell in re.split(r"(?<!\\)\|", line)[1:-1]]
            name = cells[0].strip("`")
            assert name not in rows, f"NOTATION.md has two rows for {name}"
            rows[name] = cells
    return rows


FIELDS = [
    (file, class_name, name, unit)
    for file, classes in DOCUMENTED.items()
    for class_name in classes
    for name, unit in commented_units(file, class_name).items()
]
NAMES = [name for _, _, name, _ in FIELDS]


def test_the_documented_classes_hold_every_parameter_and_state_variable():
    assert set(NAMES) == set(parameters.PARAMETER_NAMES) | set(parameters.STATE_NAMES)


@pytest.mark.parametrize(("file", "class_name", "name", "unit"), FIELDS, ids=NAMES)
def test_the_field_states_its_unit_and_notation_agrees(file, class_name, name, unit):
    assert unit, f"{file}: {class_name}.{name} needs a comment '# [unit] meaning'"
    rows = table_rows()
    assert name in rows, f"NOTATION.md has no row for {class_name}.{name}"
    assert rows[name][2] == unit, f"NOTATION.md gives {name} in {rows[name][2]}, {file} in {unit}"


@pytest.mark.parametrize("name", parameters.PARAMETER_NAMES)
def test_the_range_of_a_parameter_has_the_unit_of_its_definition(name):
    units = {field: unit for _, _, field, unit in FIELDS}
    assert parameters.RANGES[name].unit == units[name]


def test_every_row_of_the_notation_is_complete():
    for name, cells in table_rows().items():
        assert len(cells) == 5, f"row {name} has {len(cells)} cells, not 5"
        assert cells[2], f"row {name} has no unit"
        assert cells[3], f"row {name} has no meaning"
