# SPDX-License-Identifier: Apache-2.0
"""Names of the estimators, which `estimate.py` runs, and estimators of a user's own."""

from typing import Protocol, TypeAlias, runtime_checkable

import numpy as np
from attrs import frozen

from ..contract.config import Config
from ..shared.arguments import check_kind
from ..shared.errors import InputError, wrong_value
from ..shared.own_part import OwnPart, check_part
from ..shared.pulse import Pulse
from ..shared.quantities import check_choice
from .depth import Depth

METHODS = {
    "maximum": "highest bin of the pixel's histogram",
    "matched": "highest point of the histogram after filtering with the pulse",
    "background": "largest excess of hits over the expected background, corrected for the times when the tree is not armed",
    "planes": "likelihood of all events, or of all counts, fitted by planes that neighbouring pixels share",
}
DEFAULT_METHOD = "planes"
DEFAULT_SOURCE = "map"
WITHOUT_EVENTS = "because the format counts has no events"


@frozen(kw_only=True, eq=False)
class Reading:
    """What an estimator of a user's own reads.

    Attributes
    ----------
    arrays : dict of str to numpy.ndarray
        Those arrays of the result (docs/files.md) that the estimator names in `reads`.
    config : Config
        The configuration of the run.
    frame : int or None
        Only the events of this frame count; None: those of all frames.
    returns : int
        Highest number of returns per pixel.
    system_fwhm_s : float
        FWHM of laser pulse and jitter combined, in seconds.
    workers : int or None
        Threads that it may use; None is one per core. The number must not change the result.
    pulse : Pulse or None
        Measured shape of laser pulse and jitter combined, instead of that Gaussian.
    """

    arrays: dict[str, np.ndarray]
    config: Config
    frame: int | None
    returns: int
    system_fwhm_s: float
    workers: int | None
    pulse: Pulse | None = None


@runtime_checkable
class Estimator(OwnPart, Protocol):
    """An estimator of a user's own, for `estimate_depth`, `Run.depth` and `Setup.estimators`.

    Attributes
    ----------
    name, version : str
        See `OwnPart`. The name must not be one of `METHODS`.
    reads : tuple of str
        Names of the arrays of the result that it reads (docs/files.md).
    """

    @property
    def reads(self) -> tuple[str, ...]: ...

    def estimate(self, reading: Reading) -> Depth:
        """Return the depth; the third axis of its arrays may be shorter than `reading.returns`.
        See `Depth.of`.
        """
        ...


Method: TypeAlias = str | Estimator  # a name, or an estimator of a user's own
_registered: dict[str, Estimator] = {}


def register_estimator(estimator: Estimator) -> None:
    """Give a name to an estimator of a user's own, also for sweeps; it replaces an earlier one
    of this name.

    Parameters
    ----------
    estimator : Estimator
        It is known in this process only: a `Setup` that names it takes it along to others.

    Raises
    ------
    InputError
        If it is no estimator, or has the name of a built-in one.
    """
    _registered[check_estimator(estimator).name] = estimator


def check_estimator(estimator: object) -> Estimator:
    """Return an estimator of a user's own. Raises `InputError`."""
    if not isinstance(estimator, Estimator):
        raise wrong_value(
            "method", estimator, f"one of {', '.join(method_names())}, or an Estimator"
        )
    check_part("method", estimator)
    if estimator.name in METHODS:
        raise InputError(
            f"method = {estimator.name!r}: is the name of a built-in estimator", field="method"
        )
    return estimator


def method_names() -> tuple[str, ...]:
    """Return the legal names: the built-in ones, then the registered ones."""
    return (*METHODS, *_registered)


def chosen_method(method: Method) -> Method:
    """Return the name of a built-in estimator, or the estimator of a user's own that is given or
    named.

    Raises `InputError` with the legal names.
    """
    if not isinstance(method, str):
        return check_estimator(method)
    check_choice("method", method, method_names())
    return _registered.get(method, method)


def taken_along(estimators: tuple[Method, ...]) -> tuple[Method, ...]:
    """Return estimators of a setup with those of a user's own in the place of their names.
    Raises `InputError`.

    Other names stay as they are: `estimate_depth` checks them.
    """
    if isinstance(estimators, str):  # its letters would be names
        raise wrong_value("estimators", estimators, f"several, such as ({estimators!r},)")
    return tuple(_taken_along(one) for one in check_kind("estimators", estimators, tuple, list))


def _taken_along(estimator: Method) -> Method:
    if not isinstance(estimator, str):
        return check_estimator(estimator)
    name, _, source = estimator.partition("/")
    if name not in _registered:
        return estimator
    check_no_source(name, source or DEFAULT_SOURCE)
    return _registered[name]


def check_counting(method: str) -> None:
    """Raise `InputError` if a built-in estimator cannot read the format `counts`, which has no
    events.
    """
    if method != DEFAULT_METHOD:
        raise wrong_value("method", method, f"{DEFAULT_METHOD}, {WITHOUT_EVENTS}")


def check_no_source(name: str, source: str) -> None:
    """Raise `InputError` if a source is given to an estimator of a user's own, which names the
    arrays that it reads.
    """
    if source != DEFAULT_SOURCE:
        raise wrong_value(
            "source", source, f"left out, because the estimator {name} names what it reads"
        )
