# make demo: install and solve the flagship case; its figures and picture go into docs/figures.toml and the pages.
# make docs: the site, in site/html. make test: minutes. make prove: all that takes longer. make study: long trainings. make lint, make bench.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready

# Two processes: each starts with half of the tests in their order, so that a domain's compiled code
# is used again, and takes over from the other one when it has finished.
PYTEST := $(BIN)/python -m pytest
SHARED := -n 2 --dist worksteal

# What Python compiles at the first import is kept, whatever the shell says: a process that compiles
# JAX and the tests again takes seconds more, and the suites start hundreds.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: demo docs test prove lint bench study clean

demo: $(READY)
	rm -rf demo
	$(BIN)/snapo new gas-storage demo
	$(BIN)/snapo solve demo
	$(BIN)/python -m benchmarks.figures demo demo/run

test: $(READY)
	$(PYTEST) $(SHARED)

# Dask and Ray, on which a book is proved to have the same bits, come with the proofs alone.
prove: $(VENV)/.clusters
	$(PYTEST) $(SHARED) -m "prove and not study"

# Pages with code run when they change; a warning, a broken link or a request to the network fails.
docs: $(VENV)/.docs
	$(BIN)/python -m sphinx -W --keep-going -q -d site/trees docs site/html
	$(BIN)/python docs/site/links.py site/html

lint: $(READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/pyright
	$(BIN)/codespell README.md CHANGELOG.md CONTRIBUTING.md docs examples src
	$(BIN)/python -m tests.house.style

bench: $(READY)
	$(BIN)/python -m benchmarks

study: $(READY)
	$(PYTEST) -m study -o faulthandler_timeout=0

# Python compiles a module when it is first imported: most of those that are installed never are.
$(READY): pyproject.toml constraints.txt
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --no-compile --quiet --disable-pip-version-check -c constraints.txt -e '.[native,cli,parquet,pharma,test,lint]'
	touch $(READY)

$(VENV)/.clusters: $(READY)
	$(BIN)/python -m pip install --no-compile --quiet --disable-pip-version-check -c constraints.txt -e '.[native,cli,parquet,pharma,test,dask,ray]'
	touch $@

$(VENV)/.docs: $(READY)
	$(BIN)/python -m pip install --no-compile --quiet --disable-pip-version-check -c constraints.txt -e '.[native,cli,parquet,pharma,docs]'
	touch $@

clean:
	rm -rf $(VENV) demo site
