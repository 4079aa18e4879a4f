# The two commands of the README are `make demo` and `make test`; `make check` is lint and types, `make hard` the long attacks.
# PYTHON: any CPython 3.11 to 3.13 that has venv; the first one that fits is taken.
PYTHON ?= $(shell for p in python3 python3.12 python3.13 python3.11; do \
	$$p -c 'import sys, venv; sys.exit(not (3, 11) <= sys.version_info[:2] <= (3, 13))' 2>/dev/null && { echo $$p; break; }; done)
VENV ?= .venv
BIN := $(VENV)/bin
PYTEST_ARGS ?=
# Workers of the suite: one more than cores, since that which has the ROS tests mostly waits for their processes; three
# at the most, for their memory (1.6 GB each).
WORKERS ?= $(shell n=$$(nproc 2>/dev/null || echo 1); echo $$((n < 2 ? 2 : 3)))

.PHONY: demo test hard bench check docs format stale picture lock clean

demo: $(VENV)/.installed
	$(BIN)/python -m friction_estimator.cli.demo --out demo_out

# One thread of linear algebra in each of them: others only wait for it, at 18 % more processor time (a diagnosis alone).
test: export OPENBLAS_NUM_THREADS ?= 1
test: $(VENV)/.installed
	$(BIN)/python -m pytest -n $(WORKERS) --dist loadgroup --durations 20 --ignore test/hard $(PYTEST_ARGS)

# The long attacks of docs/reliability.md: minutes to hours. One of them: make hard PYTEST_ARGS=test/hard/hard_kills.py
hard: $(VENV)/.installed
	$(BIN)/python -m pytest -o python_files='hard_*.py' $(or $(PYTEST_ARGS),test/hard)

check: $(VENV)/.installed
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

# The documentation as a site, from the pages and from the code: open build/docs/index.html.
docs: $(VENV)/.installed
	$(BIN)/python -m sphinx -W --keep-going -q -c docs . build/docs
	@echo "built: build/docs/index.html"

format: $(VENV)/.installed
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

# Made aside and moved into place by the stamp only: an interrupted install is repeated, never half used.
# The lock holds everything; pip before 23.3 would look for another release of what a pin asks for with an extra.
$(VENV)/.installed: requirements.lock setup.py setup.cfg package.xml
	@test -n "$(PYTHON)" || { echo "friction_estimator needs CPython 3.11 to 3.13 with the venv module: install python3-venv or set PYTHON=/path/to/python"; exit 1; }
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --require-hashes -r requirements.lock
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation --editable .
	touch $@

# The picture of the README: the learned curve of bags/demo with its band; test/test_demo.py holds it against the plant's.
picture: $(VENV)/.installed
	$(BIN)/friction_estimator replay bags/demo --out build/picture
	cp build/picture/figures/friction_map.png docs/images/friction_map.png

# Speed and memory on one page, benchmarks/README.md; an hour, with nothing beside it. Some of it: make bench PARTS="kernels node"
# Without a network the peers are not installed: their rows are left out.
PARTS ?=
bench: $(VENV)/.installed
	-$(BIN)/python -m pip install --quiet --disable-pip-version-check -r benchmarks/requirements.txt
	$(BIN)/python benchmarks/bench.py $(PARTS)

# Pages of figures that are older than the rooms they measure.
stale:
	@python3 benchmarks/stale.py

# Needs uv, which is no run-time dependency: pip install uv.
lock:
	uv pip compile --universal --python-version 3.11 --generate-hashes --no-annotate --no-emit-index-url \
		--custom-compile-command "make lock" requirements.in -o requirements.lock

clean:
	rm -rf $(VENV) build install log demo_out docs/generated
