# SPDX-License-Identifier: Apache-2.0
# Every target sets up what it needs first (scripts/setup); `make help` lists targets and options.
BIN := .venv/bin
# A worker of pytest takes up to 1.5 GB.
WORKERS := -n logical --maxprocesses 6
# Ignore an environment or search path that the caller has activated, and keep compiled modules: there are a thousand of them.
unexport PYTHONPATH PYTHONHOME PYTHONDONTWRITEBYTECODE VIRTUAL_ENV

# $(call quoted,SCENE): the value of SCENE= as one word of the shell.
quoted = '$(subst ','\'',$(value $1))'
# $(call option,scene,SCENE): --scene 'value' if SCENE= was given.
option = $(if $(value $2),--$1 $(call quoted,$2))

.PHONY: help pages release setup sim explore check test formal upsets soak mutation coverage verilog synth gls power layout pnr cost lint figures compare modes raytrace bench clean emulate emulator docs

# A target's comment is its line in `make help`; in brackets: the list in which it appears there by name.
help:
	@echo 'make TARGET [OPTION=value ...]'
	@awk -F ':.*## ' '/^[a-z]+:.*## \[/ { split($$2, part, /[][]/); names[part[2]] = names[part[2]] " " $$1; next } \
		/^[a-z]+:.*## / { printf "  %-8s %s\n", $$1, $$2 } \
		END { for (kind in names) print kind ":" names[kind] | "sort" }' $(firstword $(MAKEFILE_LIST))
	@echo 'options of sim:'
	@echo '  SCENE=FILE UNIT=mm SCALE=3     scene; of a depth file: its unit, distances times 3,'
	@echo '  MISSING=7 SKY=80 CHANNEL=Z     no depth, nothing to see from 80 m on, EXR channel,'
	@echo '  Z=1 FOV=90 REFLECTIVITY=0.4    along the axis, its field of view, without colours'
	@echo '  KLUX=100 PULSES=100 SEED=1     ambient light ("2|100": half sun), laser pulses'
	@echo '  PULSE=pulse.csv                measured pulse of laser and detector'
	@echo '  THRESHOLD=2 FRAMES=8           threshold of one frame; frames of the controller'
	@echo '  LINK_GBPS=8 CONFIG=FILE        link (0: without limit), sensor and settings (TOML)'
	@echo '  GAP=1000                       cycles between two laser periods'
	@echo '  SIM=sliced VIEW=async WAVES=1  engine: golden, sliced, verilator, icarus;'
	@echo '                                 asynchronous front end; waveform (verilator, icarus)'
	@echo 'options of all: PYTHON=python3.12 (makes .venv), COINCID_BUILD=DIR (compiled designs)'

setup: ## [install only] what tests, proofs, flows and lint need, in .venv with pinned versions
	@scripts/setup test lint

sim: ## simulate a scene and check every word of the RTL; results in build/sim/
	@scripts/setup rtl explore $(if $(filter icarus async,$(or $(SIM),$(VIEW))),icarus)
	@$(BIN)/coincid sim $(call option,engine,SIM) $(call option,scene,SCENE) $(call option,scale,SCALE) $(call option,unit,UNIT) \
		$(call option,missing,MISSING) $(call option,sky,SKY) $(call option,channel,CHANNEL) $(if $(filter-out 0,$(Z)),--z) \
		$(call option,fov,FOV) $(call option,reflectivity,REFLECTIVITY) $(call option,threshold,THRESHOLD) \
		$(call option,frames,FRAMES) $(call option,link-gbps,LINK_GBPS) $(call option,klux,KLUX) $(call option,pulse,PULSE) \
		$(call option,pulses,PULSES) $(call option,config,CONFIG) $(call option,seed,SEED) \
		$(if $(value GAP),--set gap=$(call quoted,GAP)) $(call option,view,VIEW) $(if $(filter-out 0,$(WAVES)),--waves) \
		--out build/sim

explore: ## the effect of every setting in the browser (PORT=5006)
	@scripts/setup rtl explore
	@$(BIN)/coincid explore $(call option,port,PORT)

check: ## style and the quick tests, before a commit
	@scripts/setup test lint icarus
	@$(BIN)/ruff check .
	@$(BIN)/ruff format --check .
	@$(BIN)/python -m pytest $(WORKERS) --dist loadgroup $(PYTEST_ARGS) @tests/quick.txt

emulate: ## the emulator, simulated or on a board (PORT=/dev/ttyUSB0)
	@scripts/setup rtl explore $(if $(PORT),board)
	@$(BIN)/coincid emulate $(if $(PORT),--port $(call quoted,PORT),--simulate) $(call option,scene,SCENE) $(call option,klux,KLUX) \
		$(call option,pulses,PULSES) $(call option,frames,FRAMES) $(call option,config,CONFIG) $(call option,seed,SEED)

test: ## the whole regression, on all engines (PYTEST_ARGS="-k fifo -x")
	@scripts/setup test icarus
	@$(BIN)/python -m pytest $(WORKERS) --dist loadgroup $(PYTEST_ARGS)

formal: ## unbounded proofs of every block (NAMES="tdc tree": only these)
	@scripts/setup formal
	@$(BIN)/coincid formal $(NAMES)

upsets: ## [more checks, ARGS=--help] flip every flip-flop of a small sensor without a reset, and check that it recovers
	@scripts/setup test
	@$(BIN)/python -m tests.upsets $(ARGS)

soak: ## [more checks, ARGS=--help] 1,000 frames under sunlight and at saturation, golden model and RTL in step
	@scripts/setup test
	@$(BIN)/python -m tests.soak $(ARGS)

mutation: ## [more checks, ARGS=--help] mutate RTL, golden model and a sample of each room, and check that the regression notices
	@scripts/setup mutants icarus
	@$(BIN)/python -m tests.mutation $(ARGS)
	@$(BIN)/python -m tests.planted
	@$(BIN)/python -m tests.python_mutants

coverage: ## [more checks, ARGS=--help] situations of the contract in random frames, against their goals
	@scripts/setup test
	@$(BIN)/python -m tests.coverage $(ARGS)

verilog: ## the release: Verilog, register map, constraints; in build/rtl/
	@scripts/setup rtl
	@$(BIN)/coincid verilog $(call option,config,CONFIG) $(call option,view,VIEW) --out build/rtl

synth: ## [numbers of pages] cells, area, logic depth and LUTs of every block, into docs/synthesis.md
	@scripts/setup cells
	@$(BIN)/coincid synth

gls: ## [numbers of pages] gate-level simulation: netlists of gates and standard cells against the golden model
	@scripts/setup icarus cells
	@$(BIN)/coincid gls

power: ## [numbers of pages] mW of a subgroup and its blocks against the light, from frames on its netlist, into docs/power.md
	@scripts/setup icarus cells
	@$(BIN)/python -m docs.studies.power_against_light

layout: ## [numbers of pages] a minigroup placed, routed, checked, timed and simulated with its wires, into docs/layout.md
	@scripts/setup icarus cells layout
	@$(BIN)/coincid layout

pnr: ## [numbers of pages] place and route a module of the FPGA preset on an ECP5, into docs/place-and-route.md
	@scripts/setup flow
	@$(BIN)/coincid pnr

emulator: ## [numbers of pages] the emulator for an ULX3S: Verilog and bitstream in build/emulator/, five seeds placed and routed, into docs/emulator-board.md
	@scripts/setup flow
	@$(BIN)/coincid emulator $(call option,config,CONFIG)

cost: ## [numbers of pages] area, bits and rates against the paper's parameters, into docs/images/cost.png and .csv
	@scripts/setup cells
	@$(BIN)/python -m docs.studies.cost
	@$(BIN)/python -m docs.studies.choices

lint: ## style, types, and the Verilog under Verilator's lint
	@scripts/setup lint
	@$(BIN)/ruff check .
	@$(BIN)/ruff format --check .
	@scripts/types
	@$(BIN)/coincid lint

docs: ## the documentation as a site: build/docs/index.html
	@scripts/setup docs icarus
	@$(BIN)/python docs/build.py

figures: ## [numbers of pages] the documentation's figures
	@scripts/setup rtl explore
	@$(BIN)/python -m docs.studies.figures figures

compare: ## [numbers of pages] this sensor and other schemes on the same photons, into build/compare/
	@scripts/setup rtl
	@$(BIN)/python -m docs.studies.figures compare

modes: ## [numbers of pages] coincidence and gating, a target behind glass, 100 m: curves into build/modes/
	@scripts/setup rtl
	@$(BIN)/python -m docs.studies.figures modes --rtl

pages: ## tables and pictures of the pages (NAMES="depth controller", ONLY=stale; STALE=1 lists what is older than the code)
	@scripts/setup flow icarus cells
	@$(BIN)/python docs/pages.py $(if $(filter-out 0,$(STALE)),--stale) $(if $(filter stale,$(ONLY)),--only-stale) $(NAMES)

release: ## whether this version may be released: no page is stale, changelog and citation name it
	@scripts/setup rtl explore
	@$(BIN)/python docs/pages.py --release

raytrace: ## [install only] what ray-traced scenes need (make sim SCENE=ray:corner)
	@scripts/setup rtl explore raytrace

bench: ## speed of model and engines on this machine: build/bench.json
	@scripts/setup rtl explore icarus
	@$(BIN)/coincid bench

clean: ## remove build/ (.venv stays)
	rm -rf build
