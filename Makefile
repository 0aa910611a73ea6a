# Each target sets up what it needs: `make demo` and `make test` work on a fresh clone.
PYTHON ?= python3
BIN := .venv/bin
METHODS := plugins/benchmark/anystyle_benchmark/methods
EXTRAS := report,heic,sweeps,hub,viewer,app,words,spz
export OMP_NUM_THREADS ?= 1

.PHONY: setup demo benchmark-smoke benchmark-methods docs notebooks test tests test-smoke test-slow lint format

setup: .venv/.ready

.venv/.ready: pyproject.toml constraints.txt
	$(PYTHON) -m venv .venv
	$(BIN)/pip install --quiet --upgrade "pip>=25.1"
	$(BIN)/pip install --quiet --no-compile --constraint constraints.txt --editable ".[$(EXTRAS)]" --group dev
	# For CLIP's vocabulary alone; what the package asks for, torchvision first, is not needed.
	$(BIN)/pip install --quiet --no-deps open_clip_torch==3.3.0
	touch $@

# A real place, its cameras found and a scene fitted, then under brush strokes; the styles were chosen by looking.
demo: export OMP_NUM_THREADS = 2
demo: setup
	$(BIN)/anystyle stylize example:street --text "pink and mint watercolor" --text "charcoal drawing" \
		--image example:starry_night --image example:wave --image example:scream --image example:water_lilies \
		--export html --open --out out/demo
	$(BIN)/anystyle stylize out/demo --image example:wave --image example:scream method=brush \
		--export html --open --out out/demo-strokes

# Minutes: two scenes, three styles, three methods, judged and compared. It says whether the benchmark runs.
benchmark-smoke: RESULTS = out/benchmark-smoke
benchmark-smoke: setup
	$(BIN)/anystyle benchmark run track=smoke methods=[photographs,branch,brush] seeds=0 out=$(RESULTS)
	$(BIN)/anystyle benchmark judge $(RESULTS)
	$(BIN)/anystyle benchmark compare $(RESULTS) branch brush

# The methods that a branch adds or changes, run on the track and judged beside those of its stored edition.
benchmark-methods: BASE = origin/main
benchmark-methods: TRACK = open
benchmark-methods: RESULTS = out/benchmark-methods
benchmark-methods: BESIDE = $(wildcard docs/benchmark/$(TRACK)-2)
benchmark-methods: setup
	methods=$$(git diff --name-only --diff-filter=d $(BASE)... -- $(METHODS) | sed 's|^$(METHODS)/||; s|[./].*||' | sort -u | paste -sd,) && \
	if [ -z "$$methods" ]; then echo "no method of $(METHODS) differs from $(BASE)"; exit 0; fi && \
	$(BIN)/anystyle benchmark run track=$(TRACK) "methods=[$$methods]" out=$(RESULTS) && \
	$(BIN)/anystyle benchmark judge $(RESULTS) $(addprefix --beside ,$(BESIDE))

docs: setup
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --config-file docs/site/mkdocs.yml
	@echo "the pages are in out/docs: open out/docs/index.html"

# Runs notebooks/*.py and writes notebooks/*.ipynb, with outputs.
notebooks: setup
	$(BIN)/python tests/support/notebooks.py

# Types are checked beside the tests: that takes minutes of one core.
test: setup
	$(MAKE) --jobs 2 lint tests

tests: setup
	$(BIN)/python -m pytest -n 2 --dist worksteal -m "not slow" --durations 15

# A minute: what every other test stands on. Continuous integration runs it on the Pythons that do not run the whole suite.
SMOKE = tests/geometry tests/injectors tests/io tests/losses tests/nn tests/renderers tests/registry tests/test_types.py

test-smoke: setup
	$(BIN)/python -m pytest -n 2 --dist worksteal -m "not slow" $(SMOKE)

test-slow: setup
	$(BIN)/python -m pytest -n 2 --dist worksteal -m slow --timeout 3600

lint: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/pyright
	$(BIN)/lint-imports

format: setup
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .
