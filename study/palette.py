# SPDX-License-Identifier: Apache-2.0
"""Colours and text sizes of all pictures (Matplotlib and Bokeh). Pages have their colours in
`study/show/page.css`.
"""

# Lines and areas beside the data.
INK, DARK_GREY, GREY, LIGHT_GREY, PALE_GREY = "#222222", "#777777", "#999999", "#bbbbbb", "#eeeeee"
NO_VALUE = "#d9d9d9"  # not a colour of the map of depths
NO_VALUE_ON_PAGE, PAGE_INK = "#8c8c8c", "#7d8791"  # readable on light and dark

# For names without an order: ColorBrewer's Dark2.
GREEN, ORANGE, VIOLET, PINK = "#1b9e77", "#d95f02", "#7570b3", "#e7298a"

# For fates, verdicts and surfaces: Okabe and Ito, which colour-blind people can tell apart.
BLUE, SKY, TEAL, AMBER, VERMILION, MAUVE = (
    "#0072b2",
    "#56b4e9",
    "#009e73",
    "#e69f00",
    "#d55e00",
    "#cc79a7",
)

# For values with an order, from dark to bright: viridis.
SERIES = ("#440154", "#46327e", "#365c8d", "#277f8e", "#1fa187", "#4ac16d", "#a0da39", "#fde725")

ALARM = "#e31a1c"  # marks errors, and what needs attention

# For drawings of waveforms.
DEEP_INK, NOISE, FAINT, PALE, SIGNAL = "#1b1f24", "#6b7683", "#c4cad1", "#eef0f3", "#c8501e"

TEXT_PT, TITLE_PT, LEGEND_PT = 10, 11, 8.5  # Matplotlib
TEXT_PX, LABEL_PX, TITLE_PX = "10px", "11px", "12px"  # Bokeh
