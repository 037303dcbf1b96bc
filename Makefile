# The few commands of this project; each makes the environment it needs.

PYTHON ?= python3
BIN := .venv/bin
STAMP := .venv/.installed
WORKERS ?= 2
PIP_FLAGS := --quiet --disable-pip-version-check --no-compile -c constraints.txt
# The tests of a file stay in one process, which makes what they share once; long ones first: tests/conftest.py.
DIST := --dist loadfile --no-loadscope-reorder
PYTEST = OMP_NUM_THREADS=1 DEBLUR_AVATAR_THREADS=1 $(BIN)/python -m pytest -q -n $(WORKERS) $(DIST)
CHECKED := DEBLUR_AVATAR_CHECK_SHAPES=1

.PHONY: setup repro avatar check proof stability test types tests-once test-portable fuzz bench code relock readme clean-cache

setup: $(STAMP)

# torch comes first and alone: a CPU build that nothing later may replace. anny and mediapipe come last, without
# their own dependencies, and with npm the larger pose model: deblur_avatar/cli/setup.py.
$(STAMP): pyproject.toml constraints.txt deblur_avatar/cli/setup.py
	@$(PYTHON) -c 'import sys; sys.exit(not (3, 11) <= sys.version_info < (3, 13))' \
	  || { echo "deblur_avatar needs Python 3.11 or 3.12, as mediapipe has no wheels for others, and $(PYTHON) is" \
	    "$$($(PYTHON) --version 2>&1); set PYTHON=python3.12, say"; exit 1; }
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install $(PIP_FLAGS) torch
	$(BIN)/python -m pip install $(PIP_FLAGS) --editable '.[dev]'
	$(BIN)/python -m compileall -qq -j 0 .venv/lib || true # by all cores; pip would by one. Some files are for a newer Python
	$(BIN)/deblur-avatar setup
	@touch $(STAMP)

# All scenes but those that take long; SCENES="street street_given" makes these alone.
repro: code
	$(BIN)/deblur-avatar repro $(if $(SCENES),--scenes $(SCENES))

# From a video (or a folder of pictures) to an avatar: make avatar VIDEO=clip.mp4 [NAME=...] [METHOD=lean]
# [SCHEDULE=large]
avatar: code
	$(if $(VIDEO),,$(error make avatar needs a video: make avatar VIDEO=clip.mp4))
	$(BIN)/deblur-avatar video "$(VIDEO)" --name "$(NAME)" \
	  --method $(or $(METHOD),lean) $(if $(SCHEDULE),--schedule $(SCHEDULE))

# Says whether scenes are fit for training: data/check/<scene>/index.html. One of them: SCENE=studio.
check: code
	$(BIN)/deblur-avatar check $(SCENE)

# Every avatar with every motion on scenes that no setting was chosen on: reports/proof/index.html. Says
# first what it will take; goes on where it was stopped. PARTS="grid windows" makes these alone, PLAN=1 says it and stops.
proof: code
	$(BIN)/deblur-avatar proof $(if $(PARTS),--parts $(PARTS)) $(if $(PLAN),--plan)

# Where methods fail, on small scenes with known truth: stability/reports/index.html. As many modes at a time as there
# are cores.
stability: code
	$(BIN)/deblur-avatar sweep stability/dvc.yaml:stability_report

# Types are checked beside the tests: mypy takes one core, and tests leave some idle.
test: $(STAMP)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	PATH="$(CURDIR)/$(BIN):$$PATH" $(BIN)/lint-imports
	$(MAKE) --jobs=2 types tests-once
	$(MAKE) test-portable

types: $(STAMP)
	$(BIN)/mypy

tests-once: $(STAMP)
	$(CHECKED) $(PYTEST)

# All that computes, held back to what nearly every x86-64 processor has: AVX2. One that has no more has
# run these tests so already.
WIDER := $(shell grep -m1 -o avx512f /proc/cpuinfo 2>/dev/null)
AVX2_ONLY := ATEN_CPU_CAPABILITY=avx2 ONEDNN_MAX_CPU_ISA=AVX2 MKL_ENABLE_INSTRUCTIONS=AVX2 \
  OPENBLAS_CORETYPE=Haswell NPY_DISABLE_CPU_FEATURES="X86_V4 AVX512_ICL AVX512_SPR" OPENCV_IPP=avx2 \
  OPENCV_CPU_DISABLE=AVX512-SKX \
  DEBLUR_AVATAR_KERNEL_FLAGS=-march=x86-64-v3 DEBLUR_AVATAR_X264=asm=avx2

# The tests of what a kind of CPU may change, as on an older one; part of `make test`. Shapes were checked in the first run.
test-portable: $(STAMP)
	$(if $(WIDER),$(AVX2_ONLY) $(PYTEST) -m portable,@echo "no AVX-512 to do without: no second run")

# Hostile files for every reader of files, over 10,000; `make test` has a sample.
fuzz: $(STAMP)
	$(BIN)/python -m tests.fuzz

bench: $(STAMP)
	$(BIN)/python -m benchmarks.rasterizer

# Refreshes the fingerprints of all code (code.json) and the copies of dvc.yaml. `dvc repro` refreshes fingerprints by
# itself, `dvc repro --dry` and `dvc status` do not.
code: $(STAMP)
	$(BIN)/python -m deblur_avatar.pipeline.code

# After a pure refactoring: proves on small cases, byte by byte, that the present tree does what a commit before it did,
# and writes the locks anew; nothing runs again. make relock BASE=<commit> [RENAMED=old=new,...] [CHANGED=stage,...]
relock: $(STAMP)
	$(if $(BASE),,$(error make relock needs a commit to compare with: make relock BASE=HEAD))
	OMP_NUM_THREADS=1 $(BIN)/python -m tests.equivalence --base "$(BASE)" --renamed "$(RENAMED)" --changed "$(CHANGED)"

# Copies reports/table.md, and tables made of the proof's metrics, into docs/results.md and README.md; a test compares.
readme: $(STAMP)
	$(BIN)/python -m tests.structure.readme_table --write
