# `make demo` and `make test` set up what they need in .venv, from Python 3.11 or newer alone.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
DEMO := $(VENV)/.demo# stamp: pictures, the page and recordings have what they need
READY := $(VENV)/.ready# stamp: what tests and checks need is installed
PEERS := $(VENV)/.peers# stamp: what others' simulators need is installed too
DOCS := $(VENV)/.docs# stamp: what the documentation needs is installed
ALSO :=# `docs` installs with the tests' packages those of the documentation: the gate needs both, and pip looks once
BEFORE := b223e7d8# revision that benchmarks compare with

.PHONY: demo test test-machine kernels floors studies bench pictures check lint types wheel firmware docs linkcheck protocol clean

demo: $(DEMO)  ## drop the flotor: a summary here, pictures in figures/
	@echo 'A flotor falls on a wall at 100 phases of the sampler, with and without pulse:'
	$(BIN)/maglev-mj drop --phases 100 --out figures
	@printf '%s\n' '' 'Next, for example:'; \
	if [ -n "$$DISPLAY$$WAYLAND_DISPLAY" ]; then printf '%s\n' \
	  '  $(BIN)/maglev-mj view                       feel it in a window: drag the knob'; fi; \
	printf '%s\n' \
	  '  $(BIN)/maglev-mj view --web                 feel it in a browser: the mouse is the hand' \
	  '  $(BIN)/maglev-mj press --out figures        a hand hits the wall' \
	  '  $(BIN)/maglev-mj stick-slip --out figures   pulled out of friction' \
	  '  $(BIN)/maglev-mj map --hand arm             the stiffest wall in a hand' \
	  '  $(BIN)/maglev-mj drop --record a.maglev       a recording, for analyse, replay and convert' \
	  '  $(BIN)/maglev-mj drop --help                height, gains, rate, delay'

# tests start programs over and over, which compile the package each time where byte code is not kept
PYTESTS := env -u PYTHONDONTWRITEBYTECODE $(BIN)/python -m pytest
test: $(READY)  ## run the tests that are logic, one worker per core
	$(PYTESTS) -n logical --dist loadgroup $(PYTEST)

test-machine: $(READY)  ## run the tests with processes, sockets, clocks, windows, a browser and a board, one at a time
	$(PYTESTS) -m 'machine and not study' --durations=10 $(PYTEST)

# numbers must not hang on the processor: OpenBLAS takes the kernel that it is told
KERNELS := Prescott Nehalem Sandybridge Haswell SkylakeX
NUMERIC := tests/theory tests/analysis $(addprefix tests/,$(addsuffix .py,whole/test_golden scenes/test_stability_check \
  studies/test_design studies/test_nonlinear_walls bridge/test_identification))
PROBE := import numpy; many = numpy.random.default_rng(0).random((200, 200)); print(numpy.linalg.eigvals(many @ many).size)
kernels: $(READY)  ## run the numeric tests once under each kernel of OpenBLAS that this processor can run
	@failed=; for kernel in $(KERNELS); do \
	  export OPENBLAS_CORETYPE=$$kernel; \
	  case "$$(OPENBLAS_VERBOSE=2 $(BIN)/python -c '$(PROBE)' 2>&1 || echo died)" in \
	    *died*|*"not found"*) echo "$$kernel: left out, this processor cannot run it"; continue;; esac; \
	  echo "$$kernel:"; \
	  $(BIN)/python -m pytest -n logical --dist loadgroup $(NUMERIC) || failed="$$failed $$kernel"; \
	done; [ -z "$$failed" ] || { echo "other numbers under$$failed"; exit 1; }

FLOORS := build/floors
LOWEST := import re, tomllib; project = tomllib.load(open("pyproject.toml", "rb"))["project"]; \
  lines = sum(project["optional-dependencies"].values(), project["dependencies"]); \
  print(*sorted({f"{found[1]}=={found[2]}" for found in map(re.compile(r"([\w-]+)[^;]*>=([\d.]+)").match, lines) if found}), sep="\n")
LOW := charts,completion,control,gym,haply,mcap,pandas,parquet,serial,web# what users install, but for clips and distributed, the largest
TRIED := $(addprefix tests/,$(addsuffix .py,bridge/test_links cli/test_result interop/test_gym plants/test_plants scenes/test_drop studies/test_study) \
  studies/test_charts.py::test_settings_of_the_user_change_no_chart_and_charts_change_no_setting \
  $(addprefix views/test_web.py::,test_the_page_draws_the_robot test_a_read_only_page_has_neither_hand_nor_sliders))
# old packages stand on new ones of theirs, which warn of what is deprecated
floors:  ## install the lowest versions that pyproject.toml allows; run the README's commands and some tests, as the gate does
	rm -rf $(FLOORS)
	$(PYTHON) -m venv $(FLOORS)
	$(PYTHON) -c '$(LOWEST)' > $(FLOORS)/lowest.txt
	$(FLOORS)/bin/python -m pip --disable-pip-version-check install --quiet --constraint $(FLOORS)/lowest.txt --editable '.[$(LOW)]' \
	  pytest pytest-xdist
	$(FLOORS)/bin/maglev-mj drop --out $(FLOORS)/figures --record $(FLOORS)/drop.maglev
	$(FLOORS)/bin/maglev-mj analyse $(FLOORS)/drop.maglev
	$(FLOORS)/bin/python -m pytest -W ignore::DeprecationWarning -n logical --dist loadgroup $(TRIED)

studies: $(READY)  ## run the sweeps behind the published figures in full: minutes to an hour
	$(BIN)/python -m pytest -n logical --dist loadgroup -m study

bench: $(PEERS)  ## all benchmarks, before against after, with others' simulators: ten minutes, figures/bench.json
	$(BIN)/python scripts/benchmarks/bench.py --before $(BEFORE) --out figures

pictures: $(READY)  ## draw the pictures of the documentation anew; PICTURES='--all' also those of long studies
	$(BIN)/python scripts/figures/pictures.py $(PICTURES)

lessons: $(DOCS)  ## run the notebooks and their students' versions, and store the outputs
	$(BIN)/python scripts/lessons/store_outputs.py

docs: $(DOCS)  ## build the documentation, docs/_build/html/index.html: notebooks run, a warning is an error
	$(BIN)/python scripts/lessons/store_outputs.py --check
	rm -rf docs/reference/api  # of a room that is gone
	$(BIN)/python -m sphinx -q -j auto --write-all --fail-on-warning --keep-going docs docs/_build/html

linkcheck: $(DOCS)  ## ask for each external address of the documentation: needs a network
	$(BIN)/python -m sphinx -q -b linkcheck docs docs/_build/linkcheck

check: lint types test  ## what a change must pass

lint: $(READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(READY) $(DOCS)
	$(BIN)/mypy

# the device's firmware for a Cortex-M4, with nothing but the compiler's own arithmetic left to link
CROSS := arm-none-eabi-
M4 := -mcpu=cortex-m4 -mthumb -mfpu=fpv4-sp-d16 -mfloat-abi=hard
firmware:  ## compile the device's firmware for a Cortex-M4, and the emulated board's program; say how large they are
	@command -v $(CROSS)gcc >/dev/null || { echo 'firmware: skipped, no $(CROSS)gcc (Debian: gcc-arm-none-eabi)'; exit 0; } && \
	mkdir -p build && \
	$(CROSS)gcc -std=c99 -ffreestanding -DMAGLEV_NO_LIBRARY -Wall -Wextra -Wpedantic -Werror $(M4) -Os -fstack-usage \
	  -c scripts/firmware/maglev_firmware.c -o build/maglev_firmware.o && \
	$(CROSS)gcc -std=c99 -ffreestanding -Wall -Wextra -Wpedantic -Werror $(M4) -Os \
	  -c scripts/firmware/maglev_queue.c -o build/maglev_queue.o && \
	$(CROSS)size build/maglev_firmware.o build/maglev_queue.o && \
	if $(CROSS)nm --undefined-only build/maglev_firmware.o | grep -v __aeabi_; then \
	  echo 'firmware: a board would have to bring those'; exit 1; fi && \
	if [ -x $(BIN)/python ]; then \
	  PYTHONPATH=. $(BIN)/python scripts/firmware/boards/build.py build/board.elf && $(CROSS)size build/board.elf; \
	else echo 'firmware: no program for the emulated board, which needs the package (make demo)'; fi

protocol: $(READY)  ## write C code, tables, sizes and golden bytes from the declarations in bridge/wire.py and recording/journal.py
	PYTHONPATH=. $(BIN)/python scripts/firmware/make_protocol.py

wheel: $(READY)
	$(BIN)/python -m pip --disable-pip-version-check wheel --quiet --no-deps --wheel-dir dist .

clean:
	rm -rf $(VENV) build dist figures docs/_build docs/reference/api docs/reference/commands .mypy_cache .pytest_cache .ruff_cache

# Downloads as measured on Linux with Python 3.11; on disk 416 and 1144 MB.
$(DEMO): pyproject.toml requirements.lock
	$(call install,charts$(comma)mcap$(comma)web,,97 MB)
	@touch $@

$(READY): pyproject.toml requirements.lock
	$(call install,all,dev $(ALSO),310 MB)
	@touch $(DEMO) $@ $(if $(ALSO),$(DOCS))

$(PEERS): $(READY)
	$(call install,all,peers,280 MB)
	@touch $@

$(DOCS): pyproject.toml requirements.lock
	$(call install,charts$(comma)pandas,docs,116 MB)
	@touch $@

# requirements of dependency groups (PEP 735), which the pip of Python 3.11 cannot read itself
GROUPS := import sys, tomllib; groups = tomllib.load(open("pyproject.toml", "rb"))["dependency-groups"]; \
  print(*(line for name in sys.argv[1:] for line in groups[name]), sep="\n")

# extras of this package, dependency groups, and the size of what is downloaded for them
comma := ,
define install
@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "Python 3.11 or newer is needed: make PYTHON=...")'
@echo "Installing maglev-mj[$(1)]$(if $(2), and $(strip $(2)),) in $(VENV): about $(3) to download, unless cached."
@$(PYTHON) -m venv $(VENV) || { echo 'No venv module: on Debian, apt install python3-venv'; exit 1; }
@$(BIN)/python -c '$(GROUPS)' $(2) >$(VENV)/groups.txt
@$(BIN)/python -m pip --disable-pip-version-check install --quiet --constraint requirements.lock --editable '.[$(1)]' \
  --requirement $(VENV)/groups.txt
endef
