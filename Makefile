# Every target sets up what it needs first (scripts/setup); `make help` lists targets and options.
BIN := .venv/bin
# A caller's activated environment or search path is none of ours.
unexport PYTHONPATH PYTHONHOME VIRTUAL_ENV

# $(call option,scene,SCENE): --scene 'value' where SCENE= was given.
option = $(if $(value $2),--$1 '$(value $2)')

.PHONY: help setup sim test formal soak mutation coverage verilog synth gls pnr cost lint figures compare raytrace bench clean

help: ## this list
	@echo 'make TARGET [OPTION=value ...]'
	@awk -F ':.*## ' '/^[a-z]+:.*## / { printf "  %-8s %s\n", $$1, $$2 }' $(firstword $(MAKEFILE_LIST))
	@echo 'options of sim:'
	@echo '  SIM=icarus  or cocotb-verilator (default: the  SCENE=FILE   scene (default: five objects)'
	@echo '              RTL as a library, by Verilator)'
	@echo '  KLUX=50     background light                   PULSES=100   laser pulses in the frame'
	@echo '  CONFIG=FILE sensor configuration (TOML)        SEED=1       of the light'
	@echo '  WAVES=1     waveform (FST) and a view of it    VIEW=async   front end as on silicon (on Icarus, 4 pulses)'
	@echo 'options of test: PYTEST_ARGS="-k fifo -x"'
	@echo 'options of all: PYTHON=python3.12 makes .venv; COINCID_BUILD=DIR keeps compiled designs elsewhere than build/'

setup: ## .venv with pinned versions, and nothing else
	@scripts/setup

sim: ## simulate a frame of the scene, every word checked against the golden model; results in build/sim/
	@scripts/setup $(if $(findstring icarus,$(SIM))$(filter async,$(VIEW)),icarus)
	@$(BIN)/coincid sim $(call option,engine,SIM) $(call option,scene,SCENE) $(call option,klux,KLUX) \
		$(call option,pulses,PULSES) $(call option,config,CONFIG) $(call option,seed,SEED) \
		$(call option,view,VIEW) $(if $(filter-out 0,$(WAVES)),--waves) --out build/sim

test: ## the whole regression, on both simulators
	@scripts/setup icarus
	@$(BIN)/python -m pytest -n 2 $(PYTEST_ARGS)

formal: ## unbounded proofs of every block; logs in build/formal/ (NAMES="tdc tree": only these)
	@scripts/setup
	@$(BIN)/coincid formal $(NAMES)

soak: ## 1,000 frames under sunlight and at saturation, golden model and RTL in step (ARGS="--frames 100 --seed 2")
	@scripts/setup
	@$(BIN)/python -m tests.soak $(ARGS)

mutation: ## bugs put into RTL and golden model: does the regression see them? (ARGS="--seed 2 --rtl 500 --golden 1000")
	@scripts/setup icarus
	@$(BIN)/python -m tests.mutation $(ARGS)
	@$(BIN)/python -m tests.planted

coverage: ## situations, RTL lines and toggles, Python lines, against their goals (ARGS=functional: only these)
	@scripts/setup icarus
	@$(BIN)/python -m tests.coverage $(ARGS)

verilog: ## the release: Verilog, one file a block, register map, constraints, smoke test, into build/rtl/
	@scripts/setup
	@$(BIN)/coincid verilog $(call option,config,CONFIG) $(call option,view,VIEW) --out build/rtl

synth: ## cells, area, logic depth and LUTs of every block, into docs/synthesis.md
	@scripts/setup cells
	@$(BIN)/coincid synth

gls: ## gate-level simulation: netlists of gates and standard cells against the golden model
	@scripts/setup icarus cells
	@$(BIN)/coincid gls

pnr: ## a module of the FPGA preset placed and routed on an ECP5, into docs/place-and-route.md
	@scripts/setup
	@$(BIN)/coincid pnr

cost: ## area, bits and rates against the paper's parameters, into docs/images/cost.png and .csv
	@scripts/setup cells
	@$(BIN)/coincid cost

lint: ## Python's style, wrapping and types, and the Verilog under Verilator's lint
	@scripts/setup
	@$(BIN)/ruff check .
	@$(BIN)/ruff format --check .
	@scripts/types
	@$(BIN)/coincid lint

figures: ## the documentation's figures
	@scripts/setup
	@$(BIN)/coincid figures

compare: ## this sensor and other schemes on the same photons, into build/compare/
	@scripts/setup
	@$(BIN)/coincid compare

raytrace: ## install what ray-traced scenes need (make sim SCENE=ray:corner)
	@scripts/setup raytrace

bench: ## how fast model and simulators run here: build/bench.json, and a table beside it
	@scripts/setup icarus
	@$(BIN)/coincid bench

clean: ## remove build/ (.venv stays)
	rm -rf build
