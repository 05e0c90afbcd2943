# Every target does its own set-up; nothing else has to be typed.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin

.PHONY: sweep test suite slow browser long verify guard bench maps notebooks docs pictures lint clean

sweep: $(VENV)/run.stamp            ## sweep a PUMA 560's workspace, or go on with it: a map, a picture, a summary
	$(BIN)/ikjax sweep puma560 --spacing 0.03 --orientations 512 \
		--out out/puma560.zarr --resume --force --picture out/puma560.png

test: lint suite                    ## linter, types, fast tests with the README's examples

suite: $(VENV)/dev.stamp
	$(BIN)/python -m pytest -n auto --dist worksteal

lint: $(VENV)/dev.stamp
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

slow: $(VENV)/dev.stamp             ## what `make test` leaves out: second types, further arms, notebooks
	$(BIN)/python -m pytest -m slow -n auto --dist worksteal

browser: $(VENV)/dev.stamp          ## the viewers in a headless Chromium, which has to be installed
	$(BIN)/python -m pytest -m slow -k in_a_browser tests/plot

long: $(VENV)/dev.stamp             ## 10^6 goals an arm
	$(BIN)/python -m pytest -m long -s

verify: $(VENV)/run.stamp           ## every arm of the catalogue, judged on 10^6 goals
	$(BIN)/ikjax verify -n 1e6 --out benchmarks/VERIFY.md

guard: $(VENV)/dev.stamp            ## as fast where users stand as in our own loops? three minutes, alone
	$(BIN)/python benchmarks/guard.py

bench: $(VENV)/rivals.stamp         ## against the rivals, on the same goals
	$(BIN)/python benchmarks/run.py --out benchmarks/RESULTS.md --json out/bench.json
	$(BIN)/python benchmarks/guard.py --results benchmarks/RESULTS.md

maps: $(VENV)/rivals.stamp          ## what maps cost, and against sampled ones: a quarter of an hour, alone
	$(BIN)/python benchmarks/maps.py all --out benchmarks/MAPS.md --pictures docs

notebooks: $(VENV)/dev.stamp        ## run the notebooks again and keep their pictures
	$(BIN)/python notebooks/build.py

docs: $(VENV)/docs.stamp            ## the documentation, as pages in site/
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --quiet

pictures: $(VENV)/docs.stamp        ## draw the pictures of the documentation again
	$(BIN)/python docs/draw.py

$(BIN)/python:
	$(PYTHON) -c 'import sys; assert sys.version_info >= (3, 11), "ikjax needs Python 3.11 or newer"'
	$(PYTHON) -m venv $(VENV)

$(VENV)/run.stamp: $(BIN)/python pyproject.toml
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e '.[all]'
	touch $@

$(VENV)/dev.stamp: $(BIN)/python pyproject.toml
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e '.[all,dev,notebook,peers]'
	touch $@ $(VENV)/run.stamp

$(VENV)/docs.stamp: $(VENV)/run.stamp
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e '.[docs]'
	touch $@

$(VENV)/rivals.stamp: $(VENV)/dev.stamp
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e '.[rivals]'
	touch $@

clean:
	rm -rf $(VENV) out site
