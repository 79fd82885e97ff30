# make demo: install and solve the flagship case. make test, make lint, make bench, make study.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready

.PHONY: demo test lint bench study picture clean

demo: $(READY)
	rm -rf demo
	$(BIN)/snapo new gas-storage demo
	$(BIN)/snapo solve demo

test: $(READY)
	$(BIN)/python -m pytest -n 2 --dist loadfile

lint: $(READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/pyright

bench: $(READY)
	$(BIN)/python -m benchmarks

study: $(READY)
	$(BIN)/python -m pytest -m slow

$(READY): pyproject.toml constraints.txt
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[native,cli,parquet,pharma,test,lint]'
	touch $(READY)

clean:
	rm -rf $(VENV) demo

# The README's picture, from the demo's run folder.
picture: demo
	$(BIN)/python -c "import pathlib, snapo.domains.gas_storage.report as r; pathlib.Path('docs/storage.svg').write_text(r.readme_picture(pathlib.Path('demo/run')))"
