# SPDX-License-Identifier: Apache-2.0
"""What pulses without an event say: each of them the same, from the first one to the last."""

import numpy as np
import pytest

from coincid.lab.outcomes import Run
from coincid.lab.setup import Setup
from coincid.model.depth import likelihood
from coincid.model.depth.clusters import NEVER

PULSES = 40


@pytest.fixture
def asked(monkeypatch):
    """Arguments of `add_events` from a run of the estimator of planes."""
    calls = []
    real = likelihood.add_events

    def noted(law, events, pixels):
        calls.append((law, events, pixels))
        return real(law, events, pixels)

    monkeypatch.setattr(likelihood, "add_events", noted)
    setup = Setup.of(
        "flat:4.0,0.4",
        sensor={"rows": 8, "cols": 8},
        frame={"pulses": PULSES, "format": "compact", "link_gbps": 0},
        subgroup={"threshold": 2},
        klux=10.0,
    )
    assert np.isfinite(Run(setup).frame().depth_m).any()
    return calls[0]


def only(events, number):
    """Return the first events alone, each of them a cluster of its own."""
    others = "clusters", "alike", "shares"
    columns = {
        name: column[:number] for name, column in events._asdict().items() if name not in others
    }
    columns["since"] = np.full(number, NEVER)
    return events._replace(**columns, clusters=np.arange(number), alike=np.arange(number + 1))


def test_a_pulse_without_events_says_the_same_as_every_other(asked):
    """So nothing is said by no pulse, and a hundred pulses say a hundred times what one does."""
    law, events, pixels = asked
    said = {
        pulses: likelihood.add_events(law._replace(pulses=pulses), only(events, 0), pixels)
        for pulses in (0, 1, 100)
    }
    assert not said[0].any()
    assert said[1].min() < -0.01
    np.testing.assert_allclose(said[100], 100 * said[1], rtol=1e-5)


def test_pulses_around_an_event_are_counted_on_both_sides(asked):
    """An event takes only its own pulse out of the silent ones, near its time."""
    law, events, pixels = asked
    one = only(events, 1)
    silent = likelihood.add_events(law._replace(pulses=1), only(events, 0), pixels)
    said = []
    for pulse in (0, 5, 19):
        in_pulse = one._replace(pulse=np.full(1, pulse))
        said.append(likelihood.add_events(law._replace(pulses=20), in_pulse, pixels))
    np.testing.assert_allclose(said[1], said[0], rtol=1e-5)
    np.testing.assert_allclose(said[2], said[0], rtol=1e-5)
    longer = likelihood.add_events(
        law._replace(pulses=21), one._replace(pulse=np.zeros(1, int)), pixels
    )
    np.testing.assert_allclose(longer - said[0], silent, rtol=1e-3, atol=1e-5)


def three_events(asked, pulses, overrun, heard):
    """float32[times * lights]: what three events in some pulses of 20 say of pixels without a hit.

    heard: factor of the chance that a photon is heard, for each kind of silence.
    """
    law, events, pixels = asked
    mean = law.heard.mean * np.float32(heard)[:, None]
    law = law._replace(pulses=20, heard=law.heard._replace(mean=mean))
    events = only(events, 3)._replace(pulse=np.array(pulses), overrun=np.array(overrun))
    return likelihood.add_events(law, events, pixels)


def test_silence_before_an_overrun_is_counted_for_itself(asked):
    """Pulses between the first two events, in which windows may have been dropped, say as much as
    the others if they are heard as well, and nothing if they are not heard at all.
    """
    law, events, pixels = asked
    overrun = [False, True, False]
    alike = three_events(asked, (3, 4, 17), overrun, (1, 1))
    other = three_events(asked, (3, 14, 17), overrun, (1, 1))
    np.testing.assert_allclose(other, alike, rtol=1e-4, atol=1e-5)
    silent = likelihood.add_events(law._replace(pulses=1), only(events, 0), pixels)
    short = three_events(asked, (3, 4, 17), overrun, (1, 0))
    long = three_events(asked, (3, 14, 17), overrun, (1, 0))
    np.testing.assert_allclose(long - short, -10 * silent, rtol=1e-3, atol=1e-4)


def and_nothing(chances):
    """Return chances by kind: those of a run without drops, and 0 while windows are dropped."""
    return np.concatenate([chances, np.zeros_like(chances)])


def test_before_an_overrun_no_photon_is_missed(asked):
    """Its window may have been dropped. At the times that end just before the event, silence of its
    own pulse says as much as that of any other pulse, and nothing if the event carries `overrun` and
    no photon is heard while windows are dropped.
    """
    law, events, pixels = asked
    law = law._replace(
        heard=law.heard._replace(mean=and_nothing(law.heard.mean)), sharp=and_nothing(law.sharp)
    )
    silent = likelihood.add_events(law._replace(pulses=1), only(events, 0), pixels)
    one = only(events, 1)._replace(pulse=np.zeros(1, int))
    early = (one.quiet[0] - law.reach) // law.step - law.origin
    here = np.s_[early * law.lights : (early + 1) * law.lights]
    said = {
        overrun: likelihood.add_events(
            law._replace(pulses=1), one._replace(overrun=np.array([overrun])), pixels
        )[here]
        for overrun in (False, True)
    }
    assert silent[here].min() < -0.01
    np.testing.assert_allclose(said[False], silent[here], rtol=0.05)
    assert np.abs(said[True]).max() < 0.05 * np.abs(silent[here]).max()
