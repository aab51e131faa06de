# `make demo` and `make test` set up what they need in .venv, from Python 3.11 or newer alone.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready

SCENES := joystick drop press table box corner

.PHONY: demo test studies pictures check lint types wheel clean

demo: $(READY)  ## drop the flotor: a summary here, pictures in figures/
	$(BIN)/maglev-mj drop --phases 100 --out figures

test: $(READY)  ## run all tests, on every core
	$(BIN)/python -m pytest -n auto --dist loadgroup

studies: $(READY)  ## run the sweeps behind the published figures in full: minutes to an hour
	$(BIN)/python -m pytest -n auto --dist loadgroup -m study

pictures: $(READY)  ## draw the README's pictures of the scenes anew
	for scene in $(SCENES); do $(BIN)/maglev-mj render $$scene --out docs/images/scene_$$scene.png --width 960 --height 600 || exit 1; done
	$(BIN)/maglev-mj render joystick --out docs/images/joystick.gif --width 600 --height 375 --rate 12 --seconds 4.2

check: lint types test  ## what a change must pass

lint: $(READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(READY)
	$(BIN)/mypy

wheel: $(READY)
	$(BIN)/python -m pip --disable-pip-version-check wheel --quiet --no-deps --wheel-dir dist .

clean:
	rm -rf $(VENV) build dist figures .mypy_cache .pytest_cache .ruff_cache

$(READY): pyproject.toml requirements.lock
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "Python 3.11 or newer is needed: make PYTHON=...")'
	@$(PYTHON) -m venv $(VENV) || { echo 'No venv module: on Debian, apt install python3-venv'; exit 1; }
	$(BIN)/python -m pip --disable-pip-version-check install --quiet --constraint requirements.lock --editable '.[dev]'
	@touch $@
