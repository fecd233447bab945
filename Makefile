# Two commands matter: `make demo` and `make test`. Both make .venv themselves.
PYTHON ?= python3.11
VENV := .venv
BIN := $(VENV)/bin
# Tests at a time: more than cores, since many wait for processes and clocks.
WORKERS ?= 3
PIP := $(BIN)/python -m pip --disable-pip-version-check install --quiet --constraint constraints.txt

.PHONY: $(shell sed -n 's/^\([a-z-]*\):.*/\1/p' Makefile)

install: $(VENV)/.installed $(VENV)/.kernels
install-dev: $(VENV)/.installed-dev $(VENV)/.kernels

$(BIN)/python:
	@echo "Making $(VENV) ..."
	@$(PYTHON) -m venv $(VENV)

# The stamp is written last: an interrupted installation is repeated.
$(VENV)/.installed: pyproject.toml constraints.txt | $(BIN)/python
	@echo "Installing sawmill-calibration (about half a minute) ..."
	@$(PIP) --editable '.[all]'
	@# Type checkers follow these paths, and no import hook of an editable installation.
	@printf '%s\n' $(CURDIR)/service $(CURDIR)/worker > \
		"$$($(BIN)/python -c 'import site; print(site.getsitepackages()[0])')/sawmill-calibration.pth"
	@touch $@

# Numba keeps a compiled kernel until its own file changes; it does not know the kernels of other files that it contains.
$(VENV)/.kernels: $(shell find worker -name '_*_numba.py') | $(VENV)/.installed
	@find worker -name '*.nb[ic]' -delete
	@$(BIN)/sawmill compile
	@touch $@

$(VENV)/.installed-dev: pyproject.toml constraints.txt $(VENV)/.installed
	@echo "Installing the test tools (about half a minute) ..."
	@$(PIP) --editable '.[dev]'
	@# It asks for a typer older than ours, for its command line alone; it runs with both, and is never needed by the service.
	@$(PIP) --no-deps openapi-python-client
	@touch $@

# The newest versions that pyproject.toml allows, into constraints.txt; then `make test`. Two minutes.
pins:
	@$(PYTHON) installation/newer_pins.py

# The digests of the wheels of bundle and image, after `make pins`. Some minutes.
hashes: install-dev
	@$(BIN)/python installation/wheel_hashes.py

demo: install
	@$(BIN)/sawmill demo --output demo-output

lint: install-dev
	@$(BIN)/ruff check .
	@$(BIN)/ruff format --check .
	@$(BIN)/mypy
	@$(BIN)/lint-imports

# Before a commit, one minute: the tests that take no seconds each.
check: lint
	@$(BIN)/python -m pytest --numprocesses $(WORKERS) -m "not slow and not nightly"

# Whatever a change can break; CONTRIBUTING.md has the minutes.
test: lint
	@$(BIN)/python -m pytest --numprocesses $(WORKERS) --dist worksteal --durations 15 --durations-min 0

# What needs many repetitions: statistics over many seeds, kills by the hundred, all of storage on both databases, a
# long schemathesis run. Half an hour on two cores.
nightly: install-dev
	-@$(PIP) --no-deps openapi-generator-cli
	@$(BIN)/python -m pytest --numprocesses $(WORKERS) --dist worksteal --durations 15 --durations-min 0 --timeout 3600 -m nightly
	@$(BIN)/python -m tests.faults.inject_faults
	@$(BIN)/python tests/faults/planted.py

# The quick tests with the lowest versions that pyproject.toml allows. Ten minutes. HDF5 1.14 writes no file that is as
# hostile as two of the tests need.
NEWEST_ONLY := tests/service/browser tests/service/test_schemathesis.py tests/calibration/test_notebooks.py
lowest:
	@rm -rf .venv-lowest && $(PYTHON) -m venv .venv-lowest
	@$(PYTHON) installation/lowest_versions.py > .venv-lowest/lowest.txt
	@.venv-lowest/bin/python -m pip --disable-pip-version-check install --quiet --requirement .venv-lowest/lowest.txt \
		--editable '.[all]'
	@# Versions of Numba overwrite each other's kernels: these have a folder of their own.
	@export NUMBA_CACHE_DIR=$(CURDIR)/.venv-lowest/kernels && .venv-lowest/bin/sawmill compile && \
		.venv-lowest/bin/python -m pytest -W ignore::DeprecationWarning -m "not slow and not nightly" \
		-k "not chunk_inflates_to_2_gib and not chunk_that_unpacks_to_more" $(addprefix --ignore=,$(NEWEST_ONLY)) \
		$(addprefix tests/,tomography formats mill store calibration worker service command)

# The figures of the documents, and the wheel in an empty environment. Hours.
study: bench study-wheel

study-wheel: install-dev
	@$(BIN)/python installation/try_wheel.py

openapi: install
	@$(BIN)/sawmill openapi

# The contract as it is, as that of the release that CHANGELOG.md dates: later changes are held against it.
release-contract: openapi
	@$(BIN)/python openapi/contract_changes.py --release

# The wheel of the Python client, made from the contract, in dist/.
clients: install-dev
	@$(BIN)/python openapi/clients/generate.py dist

# New texts of the pages into the catalogues, where a person translates them.
texts: install-dev
	@cd service && ../$(BIN)/pybabel --quiet extract --mapping-file ../pyproject.toml --add-location file --sort-output \
		--output-file ../$(VENV)/sawmill.pot sawmill_service ../worker/sawmill_contracts ../worker/sawmill_mill ../worker/sawmill_vocabulary ../worker/sawmill_calibration/pictures
	@cd service && ../$(BIN)/pybabel update --input-file ../$(VENV)/sawmill.pot --output-dir sawmill_service/locale \
		--domain sawmill --width 120 --no-fuzzy-matching --ignore-obsolete --ignore-pot-creation-date

# The pages of docs/look-up that are made of the code, and the list of all pages.
docs: install-dev
	@$(BIN)/python docs/generate.py

# Studies, minutes each; every figure in the documents names the one it is from.
bench: bench-speed bench-fbp

# Is this commit slower or less exact than its parent, or than AGAINST=COMMIT? A quarter of an hour, on an idle machine.
bench-guard: install-dev
	@$(BIN)/python benchmarks/guard.py $(if $(AGAINST),--against $(AGAINST))

bench-speed: install-dev
	@$(BIN)/python benchmarks/calibration_speed.py
	@$(BIN)/python benchmarks/speed.py

bench-fbp: install-dev
	@$(BIN)/python benchmarks/reconstruction_speed.py

bench-viewer: install-dev
	@$(BIN)/python benchmarks/viewer.py

bench-pages: install-dev
	@$(BIN)/python benchmarks/pages.py

# The load of a line by queue, workers and database. OPTIONS: --quick, --parts, --databases, --workers, --queued.
study-load: install-dev
	@$(BIN)/python benchmarks/load.py $(OPTIONS)

# OPTIONS: --jobs N, --against CHECKOUT.
bench-job-price: install-dev
	@$(BIN)/python benchmarks/job_price.py $(OPTIONS)

# Do the bounds hold in each family of faults? Scans by exact chords; hours; goes on where it stopped.
# OPTIONS: --scans N, --family NAME, --jobs N, --out FILE, --write.
study-mill: install-dev
	@$(BIN)/python benchmarks/families.py $(OPTIONS)

# Drift checks of production logs by exact chords: modules, wobble, nails, slides, short turns. Goes on where it stopped;
# ten minutes of a core. OPTIONS: --logs N (of each class), --only CLASS, --out FILE, --show, --write.
study-production-logs: install-dev
	@$(BIN)/python benchmarks/production_logs.py $(OPTIONS)

# Images of logs that are turned between passages; half an hour. OPTIONS: --logs N, --views N, --size N, --shift-mm S.
study-poses: install-dev
	@$(BIN)/python benchmarks/log_poses.py $(OPTIONS)

# The contrast that a wrong geometry costs: predicted, and in images of 200 disturbed scans; two minutes. OPTIONS: --scans N,
# --write.
study-contrast: install-dev
	@$(BIN)/python benchmarks/contrast_loss.py $(OPTIONS)

# Each line of the uncertainty budget, and the errors of scans with its disturbance alone; ten minutes. OPTIONS: --scans N,
# --only LINE, --write.
study-budget: install-dev
	@$(BIN)/python benchmarks/budget.py $(OPTIONS)

# Calibrations of scanners whose object is turned between passages; ten minutes. OPTIONS: --scans N, --first N.
study-passages: install-dev
	@$(BIN)/python benchmarks/passages.py $(OPTIONS)

# Calibrations of random scanners of fixed pairs; continues where it stopped; an hour. OPTIONS: --machines N, --kind NAME,
# --passages N, --out FILE, --write.
study-pairs: install-dev
	@$(BIN)/python benchmarks/fixed_pairs.py $(OPTIONS)

# Logs on random scanners of fixed pairs: places of nails, and whether the pairs agree; half an hour. OPTIONS: --logs N,
# --out FILE, --write.
study-pair-logs: install-dev
	@$(BIN)/python benchmarks/pair_logs.py $(OPTIONS)

# Numbers of the calibration that change nothing, each set aside in turn on 100 scans; hours. OPTIONS: --scans N,
# --part N/M (one of M parts), --only NAME, --list.
study-limits: install-dev
	@$(BIN)/python benchmarks/idle_limits.py $(OPTIONS)

# The paper's own experiments for docs/evidence/paper.md; resumable. OPTIONS: --only EXPERIMENT, --full (hours).
paper: install-dev
	@$(BIN)/python benchmarks/paper_experiments.py $(OPTIONS)

# The figures of all pages, and docs/evidence, from benchmarks/results, which the commands that measure write.
figures:
	@$(PYTHON) docs/tools/figures.py
	@$(PYTHON) docs/tools/evidence.py

# The drawings of the pages, from the code (docs/pictures/fit.png was made once, at 2d38d8f3).
drawings: install-dev
	@$(BIN)/python docs/tools/geometry_drawing.py
	@$(BIN)/python docs/tools/scanner_drawings.py

# A line's logs on several machines, one of which is killed. As root, on an idle machine; half an hour. OPTIONS: --logs N.
study-machines: install-dev
	@$(BIN)/python benchmarks/two_machines.py $(OPTIONS)

# The tables of docs/understand/measured.md, where the measured discs are. Six minutes. OPTIONS: --only PART, --processes N.
measured: install-dev
	@$(BIN)/python benchmarks/measured.py $(OPTIONS)

# The tables of docs/understand/wood.md, where the CT slice is; five minutes.
wood: install-dev
	@$(BIN)/python benchmarks/tree_disc.py

# The errors that `auto` expects, and the real ones of ten logs and of the CT slice; eight minutes of a core.
study-auto: install-dev
	@$(BIN)/python benchmarks/expected_error.py --check

bench-choosing: install-dev
	@$(BIN)/python benchmarks/choosing.py
	@$(BIN)/python benchmarks/choosing.py --logs 10 --size 256 --seed 9900

# Every method on eleven logs, with the truth in hand. Continues where it stopped; 50 minutes of a core.
# OPTIONS: --logs 0-2, --settings 20:0.04, --methods NAME, --again NAME, --seconds NAME, --out FOLDER, --show.
study-logs: install-dev
	@$(BIN)/python benchmarks/log_table.py $(OPTIONS)

# No job is lost: kills, stops, outages, wrong clocks. Ten minutes. OPTIONS: --long (an hour), --only, --engine, --seed.
faults: install-dev
	@$(BIN)/python -m tests.faults.inject_faults $(OPTIONS)

# Every page in every state, language, width and colours, into SHOTS, which is outside of the repository; then the
# pictures in docs/pictures. By Debian's chromium; some minutes. OPTIONS: --data FOLDER, --only NAME.
SHOTS ?= /tmp/sawmill-screenshots
screenshots: install-dev
	@mkdir -p $(SHOTS)
	@SAWMILL_SCREENSHOTS=$(SHOTS) $(BIN)/python -m pytest --quiet -m nightly tests/service/browser/test_every_page.py
	@$(BIN)/python docs/tools/screenshots.py $(OPTIONS)

# The notebooks in examples/ with their outputs, and the page that is made from one of them. Two minutes.
notebooks: install-dev
	@$(BIN)/python docs/tools/notebooks.py
	@$(BIN)/python docs/generate.py

# One archive for a machine without a network, of the commit that is checked out, in dist/.
bundle: install-dev
	@$(BIN)/python installation/bundle.py

# The bundle in an empty environment without a network: installed, served, upgraded. Ten minutes.
try-bundle: bundle
	@$(BIN)/python installation/try_bundle.py

# The container image, by Docker or by buildah, and as an archive in dist/ (installation/image.sh).
image:
	@sh installation/image.sh

# A calibration in the image: read-only root, no capability, no network, process 1. As root; two minutes.
image-check: image
	@$(PYTHON) installation/image_check.py

# All files of a release in dist/VERSION, of the commit that is checked out. OPTIONS: --untagged, --without-image.
release: install-dev
	@$(BIN)/python installation/release.py $(OPTIONS)

clean:
	rm -rf $(VENV) build dist *.egg-info .mypy_cache .ruff_cache .pytest_cache demo-output
