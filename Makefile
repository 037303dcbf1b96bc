# The few commands of this project; each makes the environment it needs.

PYTHON ?= python3
BIN := .venv/bin
STAMP := .venv/.installed

.PHONY: setup repro avatar check stability test fuzz bench code readme clean-cache

setup: $(STAMP)

# torch comes first and alone: a CPU build that nothing later may replace. anny and mediapipe come
# without their own dependencies, which would pull 150 MB of unused code and a second OpenCV.
$(STAMP): pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' \
	  || { echo "deblur_avatar needs Python 3.11 or newer; set PYTHON=python3.12, say"; exit 1; }
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt torch
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt \
	  --editable '.[dev]'
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps -c constraints.txt \
	  anny roma mediapipe
	@touch $(STAMP)

repro: code
	$(BIN)/deblur-avatar repro

# From a video (or a folder of pictures) to an avatar: make avatar VIDEO=clip.mp4 [NAME=...] [METHOD=lean]
# [SCHEDULE=medium]
avatar: code
	$(if $(VIDEO),,$(error make avatar needs a video: make avatar VIDEO=clip.mp4))
	$(BIN)/deblur-avatar video "$(VIDEO)" --name "$(NAME)" \
	  --method $(or $(METHOD),lean) --schedule $(or $(SCHEDULE),medium)

# Says whether scenes are fit for training: data/check/<scene>/index.html. One of them: SCENE=studio.
check: code
	$(BIN)/deblur-avatar check $(SCENE)

# Where methods fail, on small scenes with known truth: stability/reports/index.html. Scenes first, then two methods
# at a time.
stability: export PATH := $(CURDIR)/$(BIN):$(PATH)
stability: export OMP_NUM_THREADS := 1
stability: code
	dvc repro stability/dvc.yaml:stability_scene
	printf '%s\n' lean paper agnostic | xargs -P 2 -I{} dvc --wait-for-lock repro -s stability/{}/dvc.yaml
	dvc repro -s stability/dvc.yaml:stability_report

test: $(STAMP)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	PATH="$(CURDIR)/$(BIN):$$PATH" $(BIN)/lint-imports
	$(BIN)/mypy
	DEBLUR_AVATAR_CHECK_SHAPES=1 $(BIN)/python -m pytest -q

# Hostile files for every reader of files, over 10,000; `make test` has a sample.
fuzz: $(STAMP)
	$(BIN)/python -m tests.fuzz

bench: $(STAMP)
	$(BIN)/python -m benchmarks.rasterizer

# Refreshes the fingerprints of all code (code.json) and the copies of dvc.yaml. `dvc repro` refreshes fingerprints by
# itself, `dvc repro --dry` and `dvc status` do not.
code: $(STAMP)
	$(BIN)/python -m deblur_avatar.pipeline.code

# Copies reports/table.md into README.md; a test compares.
readme: $(STAMP)
	$(BIN)/python -m tests.structure.readme_table --write
