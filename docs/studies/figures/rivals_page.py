# SPDX-License-Identifier: Apache-2.0
"""Writes pictures and tables of docs/rivals.md and docs/second-lidar.md; the figures are those of
`make compare`.
"""

from itertools import product
from typing import Any

from coincid.model.shared.markdown import text_table
from coincid.tools.pages import put

from . import interference, rivals
from .page_parts import made, only, per_cent, records, save

PAGE = "docs/rivals.md"
SHOWN_KLUX = (10.0, 50.0, 100.0)
# share of detected pixels that counts as seen; of wrong pixels below which targets are apart
SEEN, APART = 0.9, 0.01
BITS_ROWS = {  # row of the table of bits: scheme, threshold
    "zoomed: 16 bins": ("zoomed: 16 bins", 3),
    "zoomed: 64 bins": ("zoomed: 64 bins", 3),
    "Fourier: 8 codes": ("Fourier: 8 codes", 3),
    "Fourier: 16 codes": ("Fourier: 16 codes", 3),
    "equi-depth: 8 bins": ("equi-depth: 8 bins", 3),
    "equi-depth: 16 bins": ("equi-depth: 16 bins", 3),
    "equi-depth: 32 bins": ("equi-depth: 32 bins", 3),
    "time stamps: 16": ("time stamps: 16", 3),
    "time stamps: 64": ("time stamps: 64", 3),
    "time stamps: 128": ("time stamps: 128", 3),
    "photon counts": ("photon counts", 3),
    "winner: planes": ("winner: planes", 3),
    "sliding window": ("sliding window", 3),
    "this: threshold 2, `id`, matched": ("this: fixed", 2),
    "this: threshold 3, `id`, matched": ("this: fixed", 3),
    "this: threshold 3, `id`, planes": ("this: fixed planes", 3),
    "this: threshold 3, `compact`, planes": ("this: fixed compact planes", 3),
    "this: threshold 4, `compact`, planes": ("this: fixed compact planes", 4),
    "this: controller, `id`, planes": ("this: controller planes", 3),
    "this: controller, `compact`, planes": ("this: controller compact planes", 3),
}
BITS_COLUMNS = ((100, 10.0), (100, 50.0), (100, 100.0), (1000, 50.0), (1000, 100.0))  # pulses, klux
# row of the table: photons of the other LiDAR, offset of its period, bits of the wait
OTHER_LIDAR = {
    "no other LiDAR": (0.0, 0.0, 0),
    "same period": (0.2, 0.0, 0),
    "longer by 10 ppm": (0.2, 1e-5, 0),
    "longer by 100 ppm": (0.2, 1e-4, 0),
    "longer by 1000 ppm": (0.2, 1e-3, 0),
    "same period, wait of 0 or 1 cycle": (0.2, 0.0, 1),
    "same period, wait of 0 to 3 cycles": (0.2, 0.0, 2),
    "same period, wait of 0 to 15 cycles": (0.2, 0.0, 4),
    "same period, 1 photon, wait of 0 to 15 cycles": (1.0, 0.0, 4),
}


def schemes() -> None:
    """Write the pictures of background, range and two targets, and the table of the schemes."""
    by_background = made(rivals.background)
    save(by_background, rivals_background="rivals_background")
    put(PAGE, "background")
    by_range = made(rivals.ranging)
    save(by_range, rivals_range="rivals_range")
    put(PAGE, "range")
    by_step = made(rivals.two_targets)
    save(by_step, rivals_two_targets="rivals_two_targets")
    put(PAGE, "two targets")
    rows = []
    for scheme in rivals.SHOWN:
        wrong = {row["klux"]: row for row in only(records(by_background), scheme=scheme)}
        kbit = sorted(
            round(wrong[klux]["bits_per_frame"] / 1e3)
            for klux in rivals.KLUX
            if klux >= SHOWN_KLUX[0]
        )
        bits = f"{kbit[0]}" if kbit[0] == kbit[-1] else f"{kbit[0]} to {kbit[-1]}"
        shares = [per_cent(wrong[klux]["wrong_share"]) for klux in SHOWN_KLUX]
        rows.append((scheme, *shares, bits, _seen(by_range, scheme), _apart(by_step, scheme)))
    head = [
        "five objects, 10 klux",
        "50 klux",
        "100 klux",
        "kbit, 10 to 100 klux",
        "flat target seen to (100 klux)",
    ]
    put(PAGE, "schemes", text_table(("", *head, "two targets apart from"), rows, left=range(7)))


def _seen(section: Any, scheme: str) -> str:
    rows = only(records(section), scheme=scheme, klux=SHOWN_KLUX[-1])
    seen_m = [row["distance_m"] for row in rows if row["detected_share"] >= SEEN]
    return f"{max(seen_m):g} m" if seen_m else "never"


def _apart(section: Any, scheme: str) -> str:
    rows = only(records(section), scheme=scheme)
    right = [row["wrong_share"] < APART for row in rows]
    if not any(right):
        return "never"
    first = right.index(True)
    return f"{100 * rows[first]['step_m']:.0f} cm" + ", not at all steps" * (not all(right[first:]))


def bits() -> None:
    """Write picture and table of bits against wrong pixels."""
    section = made(rivals.bits)
    save(section, rivals_bits="rivals_bits")
    put(PAGE, "bits picture")
    found = records(section)
    rows = []
    for name, (scheme, threshold) in BITS_ROWS.items():
        cells = []
        for pulses, klux in BITS_COLUMNS:
            (row,) = only(found, scheme=scheme, threshold=threshold, pulses=pulses, klux=klux)
            cells.append(f"{per_cent(row['wrong_share'])} ({row['bits_per_frame'] / 1e3:,.0f})")
        rows.append((name, *cells))
    head = [f"{klux:g} klux, {pulses} pulses" for pulses, klux in BITS_COLUMNS]
    put(PAGE, "bits", text_table(("wrong pixels (kbit per frame)", *head), rows))


def retroreflector() -> None:
    """Write picture and table of a dark target beside a retroreflector."""
    section = made(rivals.retroreflector)
    save(section, rivals_retroreflector="rivals_retroreflector")
    put(PAGE, "retroreflector picture")
    found = records(section)
    keys = [*product(rivals.BEHIND_M, rivals.GAINS)]
    rows = []
    for scheme in rivals.SHOWN:
        of_key = [
            only(found, scheme=scheme, behind_m=behind_m, gain=gain)[0] for behind_m, gain in keys
        ]
        rows.append((scheme, *(per_cent(row["wrong_share_of_dark"]) for row in of_key)))
    put(
        PAGE,
        "retroreflector",
        text_table(("", *(f"{m:g} m, x {gain:g}" for m, gain in keys)), rows),
    )


def second_lidar() -> None:
    """Write picture and table of a second LiDAR."""
    page = "docs/second-lidar.md"
    section = made(interference.interference)
    save(section, interference="interference")
    put(page, "picture")
    found = records(section)
    rows = []
    for name, (photons, offset, bits_of_wait) in OTHER_LIDAR.items():
        key = {"photons_per_pulse": photons, "period_offset": offset, "dither_bits": bits_of_wait}
        cells = [
            only(found, scheme=scheme, **key)[0]["wrong_share"] for scheme in interference.SHOWN
        ]
        rows.append((name, *map(per_cent, cells)))
    put(page, "errors", text_table(("wrong pixels", *interference.SHOWN), rows))
