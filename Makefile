# Two commands: `make demo` bakes the shipped crossing, `make test` passes the tests in minutes.
# `make test-all` passes the slow ones too: what ships, the wheel, fuzzers, many seeds, whole bakes, second cases.
# All first make their own environment in .venv.  The machine itself is changed only where
# it is Debian or Ubuntu and you are root: a missing python3-venv or libllvm19 is installed.
# Without root libLLVM comes from the package index into .venv (x86-64 Linux).

PYTHON ?= python3
VENV   := .venv
BIN    := $(VENV)/bin
OUT    ?= out/demo
SET_OUT ?= out/mini
CLIP_OUT ?= out/clip
CLIP_SEED ?= 3
TESTS  := $(BIN)/python -m pytest -n 2 --dist loadfile

.PHONY: demo dataset clip assets test test-all test-physics test-dcc setup libs llvm lint lock wheel clean

demo: setup llvm
	$(BIN)/synfog-usd info
	$(BIN)/synfog-usd bake stages/crossroads.usda -o $(OUT) --resolution 640x360 --quality draft

# Six scenes in two lightings and four fogs, 320 x 180, with a gallery and as COCO: what a data set is like, in minutes.
dataset: setup llvm
	$(BIN)/synfog-usd dataset run mini -o $(SET_OUT)
	$(BIN)/synfog-usd dataset gallery $(SET_OUT)
	$(BIN)/synfog-usd dataset export $(SET_OUT) --as coco

# Three seconds of a drawn crossing at dusk in fog, as MP4 and GIF.
clip: setup llvm
	$(BIN)/synfog-usd compose crossroads --seed $(CLIP_SEED) --seconds 3 --fps 10 -o $(CLIP_OUT)/street.usda
	$(BIN)/synfog-usd bake $(CLIP_OUT)/street.usda -o $(CLIP_OUT)/frames --frames 0:29 --lighting active --fog mor150 --quality draft --resolution 640x360
	$(BIN)/python -m docs.studies.clip $(CLIP_OUT)/frames $(CLIP_OUT)/clip.gif

test: setup llvm
	$(TESTS)

test-all: setup llvm
	$(TESTS) -m "not physics and not bench and not gpu"

# Hours: Monte Carlo to a per mille, and ratios against named peers.
test-physics: setup llvm
	$(BIN)/python -m pytest -m "physics or bench"

# The Blender round trip; bpy 5.0.1 takes Python 3.11 and 1 GB.  SYNFOG_BPY names another Python that has it.
SYNFOG_BPY ?= .venv-bpy/bin/python
test-dcc: setup llvm
	@test -x $(SYNFOG_BPY) || { python3.11 -m venv .venv-bpy && .venv-bpy/bin/python -m pip install -q --disable-pip-version-check bpy==5.0.1; }
	SYNFOG_BPY=$(SYNFOG_BPY) $(BIN)/python -m pytest tests/dcc tests/translate/test_volume.py

# Every shipped model, texture, lamp, stage and sky again, byte for byte; see assets/builders.
assets: setup
	$(BIN)/python -m assets.builders

lint: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

setup: $(VENV)/.done

$(VENV)/.done: pyproject.toml constraints.txt
	@rm -rf $(VENV)
	@$(PYTHON) -m venv $(VENV) >/dev/null 2>&1 \
	 || { rm -rf $(VENV); $(PYTHON) -m virtualenv -q $(VENV) 2>/dev/null; } \
	 || { rm -rf $(VENV); uv venv -q --seed --python $(PYTHON) $(VENV) 2>/dev/null; } \
	 || { rm -rf $(VENV); [ "$$(id -u)" = 0 ] && command -v apt-get >/dev/null && echo "installing python3-venv" \
	      && apt-get update -qq && apt-get install -y -qq python3-venv >/dev/null && $(PYTHON) -m venv $(VENV); } \
	 || { echo "$(PYTHON) cannot make a virtual environment: install python3-venv (Debian, Ubuntu: apt install python3-venv) and try again"; exit 2; }
	$(BIN)/python -m pip install -q --disable-pip-version-check -c constraints.txt -e ".[dev,sets]"
	@touch $@

# What the wheels of Dr.Jit (libatomic) and PyMeshLab (libGL, libOpenGL) expect of the system; a Debian without a desktop has none of it.
LIBS := libatomic1 libgl1 libopengl0
libs: setup
	@$(BIN)/python -c "import ctypes as c; [c.CDLL(name) for name in ('libatomic.so.1', 'libGL.so.1', 'libOpenGL.so.0')]" 2>/dev/null \
	 || { [ "$$(id -u)" = 0 ] && command -v apt-get >/dev/null && echo "installing $(LIBS)" \
	      && apt-get update -qq && apt-get install -y -qq --no-install-recommends $(LIBS) >/dev/null; } \
	 || { echo "libatomic.so.1, libGL.so.1 or libOpenGL.so.0 is missing: install $(LIBS) (Debian, Ubuntu: apt install $(LIBS)) and try again"; exit 2; }

# Mitsuba compiles its kernels with libLLVM 16 or newer; without one it renders in its scalar mode.
llvm: libs
	@$(BIN)/python -c "import sys; from synfog_usd.render import backend as b; sys.exit(not (b.find_llvm()[0] or b.has_cuda_driver()))" \
	 || { [ "$$(id -u)" = 0 ] && command -v apt-get >/dev/null && echo "installing libllvm19" \
	      && apt-get update -qq && apt-get install -y -qq libllvm19 >/dev/null; } \
	 || { echo "no libLLVM 16 or newer and no root: taking it from the package index" \
	      && $(BIN)/python -m pip install -q --disable-pip-version-check -c constraints.txt -e ".[llvm]" \
	      && $(BIN)/python -c "import sys; from synfog_usd.render import backend as b; sys.exit(not b.find_llvm()[0])"; } \
	 || $(BIN)/python -c "from synfog_usd.render import backend as b; print('no libLLVM 16 or newer:', b.SCALAR_COST)"

lock:
	uv pip compile pyproject.toml --universal --extra dev --extra llvm --extra sets --python-version 3.10 --no-header --no-annotate -o constraints.txt

wheel: setup
	$(BIN)/python -m build

clean:
	rm -rf $(VENV) .venv-bpy build dist out *.egg-info
