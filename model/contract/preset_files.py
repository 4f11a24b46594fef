# SPDX-License-Identifier: Apache-2.0
"""Presets: configuration files that come with the project, by name."""

from pathlib import Path

PRESETS = {path.stem: path for path in sorted(Path(__file__).with_name("presets").glob("*.toml"))}
