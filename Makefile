# SPDX-License-Identifier: Apache-2.0
# Every target sets up what it needs first (scripts/setup); `make help` lists targets and options.
BIN := .venv/bin
# Ignore an environment or search path that the caller has activated, and keep compiled modules: there are a thousand of them.
unexport PYTHONPATH PYTHONHOME PYTHONDONTWRITEBYTECODE VIRTUAL_ENV

# $(call option,scene,SCENE): --scene 'value' if SCENE= was given.
option = $(if $(value $2),--$1 '$(value $2)')

.PHONY: help setup sim explore check test formal upsets soak mutation coverage verilog synth gls power layout pnr cost lint figures compare modes raytrace bench clean emulate emulator docs

help: ## this list
	@echo 'make TARGET [OPTION=value ...]'
	@awk -F ':.*## ' '/^[a-z]+:.*## / { printf "  %-8s %s\n", $$1, $$2 }' $(firstword $(MAKEFILE_LIST))
	@echo 'options of sim:'
	@echo '  SCENE=FILE     scene (default: sun-and-shade)      SCALE=3       distances of a depth file times 3'
	@echo '  KLUX=100       ambient light ("2|100": half sun)   PULSES=100    laser pulses in a frame'
	@echo '  THRESHOLD=2    of one frame (default: the best)    FRAMES=8      in which the controller settles'
	@echo '  LINK_GBPS=8    rate of the link; 0: no limit       CONFIG=FILE   sensor configuration (TOML)'
	@echo '  SEED=1         of the light                        WAVES=1       waveform (FST) and views of it'
	@echo '  UNIT=mm      of a depth file: m, cm, 1/5000, tum, sun-rgbd ... (coincid sim --help)'
	@echo '  SIM=sliced     or golden, verilator, icarus        VIEW=async    front end as on silicon (verilator or'
	@echo '                 (the last two: under cocotb)                      icarus, the default; 4 pulses)'
	@echo 'options of test: PYTEST_ARGS="-k fifo -x"'
	@echo 'options of all: PYTHON=python3.12 makes .venv; COINCID_BUILD=DIR keeps compiled designs elsewhere than build/,'
	@echo '  COINCID_OPTIMISE=-O1 compiles them faster, and they run 5 % slower'

setup: ## .venv with pinned versions, and nothing else
	@scripts/setup

sim: ## simulate a frame of the scene and check every word against the golden model; results in build/sim/
	@scripts/setup $(if $(filter icarus async,$(or $(SIM),$(VIEW))),icarus)
	@$(BIN)/coincid sim $(call option,engine,SIM) $(call option,scene,SCENE) $(call option,scale,SCALE) $(call option,unit,UNIT) $(call option,threshold,THRESHOLD) \
		$(call option,frames,FRAMES) $(call option,link-gbps,LINK_GBPS) $(call option,klux,KLUX) \
		$(call option,pulses,PULSES) $(call option,config,CONFIG) $(call option,seed,SEED) \
		$(call option,view,VIEW) $(if $(filter-out 0,$(WAVES)),--waves) --out build/sim

explore: ## show the effect of every setting in the browser (PORT=5006)
	@scripts/setup
	@$(BIN)/coincid explore $(call option,port,PORT)

check: ## quick checks before a commit: style, and the tests of tests/quick.txt
	@scripts/setup icarus
	@$(BIN)/ruff check .
	@$(BIN)/ruff format --check .
	@$(BIN)/python -m pytest -n 2 --dist loadgroup $(PYTEST_ARGS) @tests/quick.txt

emulate: ## the simulated emulator behind its serial pins, every word checked (PORT=/dev/ttyUSB0: on a board); depth in build/emulate/
	@scripts/setup
	@$(BIN)/coincid emulate $(if $(PORT),--port '$(value PORT)',--simulate) $(call option,scene,SCENE) $(call option,klux,KLUX) \
		$(call option,pulses,PULSES) $(call option,frames,FRAMES) $(call option,config,CONFIG) $(call option,seed,SEED)

test: ## the whole regression, on both simulators
	@scripts/setup icarus
	@$(BIN)/python -m pytest -n 2 --dist loadgroup $(PYTEST_ARGS)

formal: ## unbounded proofs of every block; logs in build/formal/ (NAMES="tdc tree": only these)
	@scripts/setup
	@$(BIN)/coincid formal $(NAMES)

upsets: ## flip every flip-flop of a small sensor without a reset, and check that it recovers (ARGS="--instants 8 --seed 2")
	@scripts/setup
	@$(BIN)/python -m tests.upsets $(ARGS)

soak: ## 1,000 frames under sunlight and at saturation, golden model and RTL in step (ARGS="--frames 100 --seed 2")
	@scripts/setup
	@$(BIN)/python -m tests.soak $(ARGS)

mutation: ## mutate RTL and golden model, and check that the regression notices (ARGS="--seed 2 --rtl 500 --golden 1000")
	@scripts/setup icarus
	@$(BIN)/python -m tests.mutation $(ARGS)
	@$(BIN)/python -m tests.planted

coverage: ## situations, RTL lines and toggles, Python lines, against their goals (ARGS=functional: only these)
	@scripts/setup icarus
	@$(BIN)/python -m tests.coverage $(ARGS)

verilog: ## the release: Verilog, one file per block, register map, constraints, smoke test, into build/rtl/
	@scripts/setup
	@$(BIN)/coincid verilog $(call option,config,CONFIG) $(call option,view,VIEW) --out build/rtl

synth: ## cells, area, logic depth and LUTs of every block, into docs/synthesis.md
	@scripts/setup cells
	@$(BIN)/coincid synth

gls: ## gate-level simulation: netlists of gates and standard cells against the golden model
	@scripts/setup icarus cells
	@$(BIN)/coincid gls

power: ## mW of a subgroup and its blocks against the light, from frames on its netlist, into docs/power.md
	@scripts/setup icarus cells
	@$(BIN)/coincid power

layout: ## a minigroup placed, routed, checked, timed and simulated with its wires, into docs/layout.md
	@scripts/setup icarus cells layout
	@$(BIN)/coincid layout

pnr: ## place and route a module of the FPGA preset on an ECP5, into docs/place-and-route.md
	@scripts/setup
	@$(BIN)/coincid pnr

emulator: ## the emulator for an ULX3S: Verilog and bitstream in build/emulator/, five seeds placed and routed, into docs/emulator-board.md
	@scripts/setup
	@$(BIN)/coincid emulator $(call option,config,CONFIG)

cost: ## area, bits and rates against the paper's parameters, into docs/images/cost.png and .csv
	@scripts/setup cells
	@$(BIN)/coincid cost

lint: ## Python's style, wrapping and types, and the Verilog under Verilator's lint
	@scripts/setup
	@$(BIN)/ruff check .
	@$(BIN)/ruff format --check .
	@scripts/types
	@$(BIN)/coincid lint

docs: ## the documentation as a site, with API reference and examples that are run: build/docs/index.html
	@scripts/setup docs icarus
	@$(BIN)/python docs/build.py

figures: ## the documentation's figures
	@scripts/setup
	@$(BIN)/coincid figures

compare: ## this sensor and other schemes on the same photons, into build/compare/
	@scripts/setup
	@$(BIN)/coincid compare

modes: ## coincidence and gating, a target behind glass, 100 m: curves into build/modes/
	@scripts/setup
	@$(BIN)/coincid modes --rtl

raytrace: ## install what ray-traced scenes need (make sim SCENE=ray:corner)
	@scripts/setup raytrace

bench: ## measure the speed of model and simulators on this machine: build/bench.json, and a table beside it
	@scripts/setup icarus
	@$(BIN)/coincid bench

clean: ## remove build/ (.venv stays)
	rm -rf build
