# Two commands on a fresh machine: `make demo` and `make test`. Both install what they need into .venv.
VENV ?= .venv
PYTHON ?= $(shell command -v python3.11 || command -v python3)
BIN = $(abspath $(VENV))/bin
SOURCES = pwm_gym_cli.py $(shell find pwm_gym envs wrappers -type f -not -name '*.pyc')
export OMP_NUM_THREADS ?= 2
TASK ?= PickCube# of `make demo`

# Files go to the processes in their order, whose last ones are short, so that both processes end together.
PYTEST = $(BIN)/pytest -n 2 --dist loadfile --no-loadscope-reorder

.PHONY: demo test test-all test-extras coverage lint docs install clean

install: $(VENV)/.package

$(VENV)/.dependencies: pyproject.toml constraints.txt
	$(PYTHON) -m venv $(VENV)
	$(BIN)/pip install -q --disable-pip-version-check -c constraints.txt torch
	$(BIN)/pip install -q --disable-pip-version-check -c constraints.txt '.[dev]'
	$(BIN)/pip uninstall -q -y pwm-gym
	touch $@

# The package itself is installed as a wheel, so that the tests see what a user gets.
$(VENV)/.package: $(VENV)/.dependencies $(SOURCES) pyproject.toml
	rm -rf build/lib build/bdist.*
	$(BIN)/pip install -q --disable-pip-version-check --no-deps --force-reinstall .
	rm -rf build/lib build/bdist.* *.egg-info
	touch $@

demo: $(VENV)/.package
	$(BIN)/pwm-gym demo --task $(TASK)

lint: $(VENV)/.package
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	cd tests && $(BIN)/mypy --config-file ../pyproject.toml -p pwm_gym

test: lint
	$(PYTEST)

test-all: lint
	$(PYTEST) -m 'slow or not slow'

# Which lines the tests run; not a part of `make test`, which it would slow down.
coverage: $(VENV)/.package
	$(PYTEST) --cov=pwm_gym --cov-report=term --cov-report=xml

# Bridges into libraries that few users need: each is tested against the library itself.
$(VENV)/.extras: $(VENV)/.dependencies
	$(BIN)/pip install -q --disable-pip-version-check -c constraints.txt '.[ray,stable-worldmodel,warp]'
	rm -rf build/lib build/bdist.* *.egg-info
	touch $@

test-extras: $(VENV)/.extras $(VENV)/.package
	$(BIN)/pytest -rs -m 'slow or not slow' tests/test_cluster.py tests/planning/test_adapters.py tests/sim/test_warp.py

$(VENV)/.docs: $(VENV)/.dependencies
	$(BIN)/pip install -q --disable-pip-version-check -c constraints.txt '.[docs]'
	rm -rf build/lib build/bdist.* *.egg-info
	touch $@

docs: $(VENV)/.docs $(VENV)/.package
	$(BIN)/sphinx-build -q -W --keep-going -d build/doctrees docs build/docs
	$(BIN)/python docs/check_links.py build/docs
	@echo "open build/docs/index.html"

clean:
	rm -rf $(VENV) build *.egg-info demo .mypy_cache .ruff_cache .pytest_cache
