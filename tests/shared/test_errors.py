# SPDX-License-Identifier: Apache-2.0
"""Errors that users read carry the field and its legal range, so that no reader has to take their
message apart.
"""

import ast
import pickle
from itertools import chain
from pathlib import Path

import pytest

from coincid.lab.setup import Setup
from coincid.model.contract.coincidence import Rule, check_rule
from coincid.model.contract.config import load_config, parse_config
from coincid.model.shared.errors import BEHIND_FIELD, InputError, check_integer
from coincid.model.shared.quantities import check_choice, check_real


@pytest.mark.parametrize(
    "document, field, low, high",
    [
        ({"frame": {"pulses": 0}}, "frame.pulses", 1, 1 << 16),
        ({"frame": {"clock_mhz": 0.0}}, "frame.clock_mhz", 1e-3, 1e5),
        ({"frame": {"link_gbps": 1e-9}}, "frame.link_gbps", 0.03125, 1e6),
        ({"frame": {"auto_bounds": [1]}}, "frame.auto_bounds", 0, (1 << 32) - 1),
        ({"frame": {"period": 1}}, "frame.period", 6, 1 << 10),
        ({"sensor": {"phases": 12}}, "sensor.phases", 4, 64),
        ({"sensor": {"rows": 7}}, "sensor.rows", None, None),
        ({"sensor": {"moon": 7}}, "sensor.moon", None, None),
        ({"subgroup": {"threshold": 65}}, "subgroup.threshold", 1, 64),
        ({"subgroup": {"gating": 1}}, "subgroup.gating", None, None),
        ({"subgroup": {"gating": True, "gate_start": 300}}, "subgroup.gate_start", 0, 249),
        ({"override": [{"subgroups": [99]}]}, "override[0].subgroups", 0, 15),
    ],
)
def test_an_error_of_the_configuration_has_its_field_and_range(document, field, low, high):
    with pytest.raises(InputError) as raised:
        parse_config(document)
    assert (raised.value.field, raised.value.low, raised.value.high) == (field, low, high)
    assert str(raised.value).startswith(field)


@pytest.mark.parametrize(
    "load, words",
    [
        (lambda: load_config({"sensor": {}}), "config = dict: must be a TOML file or a preset; p"),
        (lambda: load_config("fpga", {"moon": 3}), "moon: unknown setting, must be one of rows"),
        (lambda: load_config("fpga", [3]), "changes = list: must be a dict of values by key"),
        (lambda: parse_config("fpga"), "document = str: must be a dict of tables; load_config"),
    ],
)
def test_a_configuration_of_another_kind_is_refused(load, words):
    with pytest.raises(InputError, match=words):
        load()


def test_a_long_value_is_told_by_its_beginning():
    mask = [True] * 4096
    with pytest.raises(InputError) as raised:
        parse_config({"subgroup": {"mask": mask}})
    message = str(raised.value)
    assert message.startswith("subgroup.mask = [True, True,")
    assert len(message) < 200
    assert "must be a string of hex digits below 2^64" in message


def test_a_change_is_blamed_for_an_error_in_another_field():
    with pytest.raises(
        InputError, match=r"^sensor\.coarse_bits: does not go with .*\(frame\.period = 63"
    ) as raised:
        load_config("fpga", {"coarse_bits": 5})
    assert raised.value.field == "sensor.coarse_bits"
    with pytest.raises(InputError, match=r"^frame\.period = 1: must be an integer from") as raised:
        load_config("fpga", {"period": 1})
    assert raised.value.field == "frame.period"


@pytest.mark.parametrize(
    "check, message",
    [
        (lambda: check_integer("frames", 9, 1, 8), "Frames = 9: must be an integer from 1 to 8"),
        (lambda: check_real("frames", 9, 1, 8), "Frames = 9: must be a number from 1 to 8"),
        (lambda: check_choice("frames", "9", ("1", "8")), "Frames = '9': must be one of 1, 8"),
    ],
)
def test_a_field_can_be_told_by_another_name(check, message):
    with pytest.raises(InputError) as raised:
        check()
    assert raised.value.renamed("Frames") == message
    # In front of a message comes the file; the field is then inside of it, and stays the attribute.
    within = raised.value.within("a.toml")
    assert str(within) == f"a.toml: {raised.value}"
    assert within.field == "frames"


def test_a_message_without_a_field_stays_as_it_is_under_any_name():
    for error in (InputError("frames: are few"), InputError("frames: are few", field="pulses")):
        assert error.renamed("Frames") == "frames: are few"


def test_an_error_comes_back_from_another_process():
    with pytest.raises(InputError) as raised:
        Setup.of("flat:5,0.4", frame={"pulses": 0})
    back = pickle.loads(pickle.dumps(raised.value))
    assert str(back) == str(raised.value)
    assert (back.field, back.low, back.high) == ("frame.pulses", 1, 1 << 16)


def test_an_error_keeps_its_field_and_range_behind_the_name_of_its_file(tmp_path):
    path = tmp_path / "my.toml"
    path.write_text("[frame]\npulses = 0\n", encoding="utf-8")
    with pytest.raises(InputError) as alone:
        parse_config({"frame": {"pulses": 0}})
    with pytest.raises(InputError) as in_file:
        load_config(path)
    assert str(in_file.value) == f"{path}: {alone.value}"
    for name in ("field", "low", "high"):
        of_both = [getattr(one.value, name) for one in (alone, in_file)]
        assert of_both[0] is not None and of_both[0] == of_both[1]


class WithoutCircuit(Rule):
    """A rule of a user's own that only the golden model plays."""

    name, version = "mine", "1"


@pytest.mark.parametrize(
    ("refused", "message"),
    [
        (lambda: check_rule(3), "sensor.rule = 3: must be a Rule"),
        (WithoutCircuit().check_circuit, "sensor.rule = 'mine': has no circuit"),
    ],
)
def test_an_error_of_the_rule_has_its_field(refused, message):
    with pytest.raises(InputError) as raised:
        refused()
    assert str(raised.value).startswith(message)
    assert raised.value.field == "sensor.rule"


ROOT = Path(__file__).parents[2]
ROOMS = ("model", "tools", "host", "hdl", "slices", "tb", "formal", "flow", "lab", "study", "board")


def told_fields(function):
    """Yield (message, field) of the errors that a function makes, as far as both are in its text.

    A message is what stands before its first part that is computed.
    """
    texts = {}
    for node in sorted(ast.walk(function), key=lambda node: getattr(node, "lineno", 0)):
        if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name):
            texts[node.targets[0].id] = node.value
        if not (isinstance(node, ast.Call) and getattr(node.func, "id", "") == "InputError"):
            continue
        fields = [word.value for word in node.keywords if word.arg == "field"]
        message = node.args[0]
        if isinstance(message, ast.Name):
            message = texts.get(message.id)
        begin = message.values[0] if isinstance(message, ast.JoinedStr) else message
        if fields and isinstance(begin, ast.Constant) and isinstance(fields[0], ast.Constant):
            yield begin.value, fields[0].value


def test_a_message_begins_with_the_field_that_its_error_names():
    """Or with a part of it, such as one of its arrays. Readers put another name in its place."""
    found = []
    for path in sorted(chain(*((ROOT / room).rglob("*.py") for room in ROOMS))):
        for function in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(function, ast.FunctionDef):
                found += [(path.name, *told) for told in told_fields(function)]
    assert len(found) > 10
    for path, message, field in found:
        begins = [f"{field}{behind}" for behind in (*BEHIND_FIELD, ".")]
        assert message.startswith(tuple(begins)), (path, message, field)
