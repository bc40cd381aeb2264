# make demo   scan the kedge phantom, reconstruct it, print the scores
# make test   run the test suite but for its slow tests; TESTS="tests/spectra" for a part
# make test-slow  run the slow tests
# make coverage  run all tests, and report the lines that none runs
# make test-isa  the tests but for the slow ones and those of GPUs as processors with other instructions run them; ISA_TESTS="tests/recon" for a part
# make test-oldest  the tests but for the slow ones with the oldest versions of dependencies that pyproject.toml allows; needs uv
# make test-newest  the same with the newest versions; needs uv
# make fuzz   try FUZZ=1000 spoiled inputs per test, seed SEED, which is printed
# make check  formatting, lint, import contracts, docstrings, types
# make docs   build the documentation site, docs/_build/html; GALLERY=1 runs the example scripts as well, some minutes
# make numbers  run the commands behind the numbers of README and docs; say which no longer hold (ONLY=readme, SLOW=1)
VENV := .venv
ifeq ($(OS),Windows_NT)
PYTHON ?= python
BIN := $(VENV)/Scripts
EXE := .exe
else
PYTHON ?= python3
BIN := $(VENV)/bin
endif

# instruction sets of numba / of torch; an x86-64 processor with AVX2 can run all of these
INSTRUCTIONS := x86-64/default x86-64-v3/avx2
TESTS ?= tests
FUZZ ?= 1000
SEED ?= $(shell date +%s)
ISA_TESTS ?= tests
PYTEST := $(BIN)/python -m pytest --numprocesses auto --dist loadfile

.PHONY: demo test test-slow coverage test-isa test-oldest test-newest fuzz check docs numbers clean

demo: $(VENV)/installed
	$(BIN)/phantomgen make --preset kedge --overwrite
	$(BIN)/recon fit kedge.h5 --overwrite

test: $(VENV)/installed-test
	$(PYTEST) -m "not slow" $(TESTS)

# Types of arguments are checked by `make test`: checks take a quarter of the time of tests.
test-slow: $(VENV)/installed-test
	CHECKED_TYPES= $(PYTEST) -m slow $(TESTS)

coverage: $(VENV)/installed-test
	$(PYTEST) --cov --cov-report=term:skip-covered $(TESTS)

test-isa: $(VENV)/installed-test
	set -e; for setting in $(INSTRUCTIONS); do echo "$$setting"; \
		env CHECKED_TYPES= NUMBA_CPU_NAME=$${setting%/*} ATEN_CPU_CAPABILITY=$${setting#*/} $(BIN)/python -m pytest --quiet --numprocesses auto --dist loadfile -m "not slow" --ignore-glob="*gpu*" $(ISA_TESTS); done
	$(BIN)/python -m benchmarks.reconstruction.processors

# Old libraries warn of what newer ones changed, so that warnings are no errors here; types are checked by `make test`.
test-oldest:
	uv venv --quiet --clear --python $(PYTHON) $(VENV)-oldest
	uv pip install --quiet --python $(VENV)-oldest --resolution lowest-direct --editable '.[test]'
	CHECKED_TYPES= $(VENV)-oldest/$(notdir $(BIN))/python -m pytest --numprocesses auto --dist loadfile -m "not slow" -o filterwarnings=default $(TESTS)

test-newest:
	uv venv --quiet --clear --python $(PYTHON) $(VENV)-newest
	uv pip install --quiet --python $(VENV)-newest --resolution highest --editable '.[test]'
	$(VENV)-newest/$(notdir $(BIN))/python -m pytest --numprocesses auto --dist loadfile -m "not slow" $(TESTS)

fuzz: $(VENV)/installed-test
	@echo "FUZZ=$(FUZZ) SEED=$(SEED)"
	FUZZ=$(FUZZ) $(BIN)/python -m pytest tests/fuzz --hypothesis-seed=$(SEED)

check: $(VENV)/installed-dev
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/lint-imports
	$(BIN)/python -m benchmarks.check_docstrings
	$(BIN)/pyright --pythonpath $(BIN)/python

docs: $(VENV)/installed-docs
	$(BIN)/python -m sphinx -b html -W --keep-going docs docs/_build/html

numbers: $(VENV)/installed
	$(BIN)/python -m benchmarks.check_numbers $(if $(ONLY),--only $(ONLY)) $(if $(SLOW),--slow) $(if $(SCRATCH),--scratch $(SCRATCH) --resume)

clean:
	rm -rf $(VENV) $(VENV)-oldest $(VENV)-newest build dist *.egg-info

$(BIN)/python$(EXE):
	$(PYTHON) -m venv $(VENV)

$(VENV)/installed: pyproject.toml constraints.txt | $(BIN)/python$(EXE)
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable .
	touch $@

$(VENV)/installed-test: pyproject.toml constraints.txt | $(BIN)/python$(EXE)
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable '.[test]'
	touch $@ $(VENV)/installed

$(VENV)/installed-docs: pyproject.toml constraints.txt | $(BIN)/python$(EXE)
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable '.[docs]'
	touch $@ $(VENV)/installed

$(VENV)/installed-dev: pyproject.toml constraints.txt | $(BIN)/python$(EXE)
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable '.[dev]'
	touch $@ $(VENV)/installed-test $(VENV)/installed
