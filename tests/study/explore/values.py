# SPDX-License-Identifier: Apache-2.0
"""Values of controls that differ from their defaults."""

from coincid.model.shared.errors import InputError
from coincid.study.explore.control_values import check_settings
from coincid.study.explore.controls import Control

OTHER = dict(scene="two-targets", rows=16, cols=64, subgroup="4x8", minigroup="4x4", format="full", method="maximum")


def other_value(control: Control):
    """Return a legal value that is not the default: the next one that the other controls allow."""
    if control.name in OTHER:
        return OTHER[control.name]
    if control.kind == "switch":
        return not control.default
    if control.kind == "choice":
        return next(choice for choice in control.choices if choice not in (control.default, "picture", "upload"))
    default = 0 if control.default is None else control.default
    near = default + control.step, default - control.step, default // 2
    return next(value for value in near if _is_legal({control.name: value}))


def _is_legal(values):
    try:
        return bool(check_settings(values))
    except InputError:
        return False
