# make run        linearize the two-link arm into out/ and print its table
# make test       all checks: style, import contracts, tests, types among them
# make test-long  tests that run for minutes, all tests as other processors would run them, planted bugs, attacks
# make attack     damaged, hostile, absurd and random inputs: ATTACK="--minutes 30 --only archives,matrices"
# make mutants    planted bugs: each must fail a test
# make docs       the documentation as web pages, out/site/index.html
# make bench      measure, and write the tables into docs/; print those of the UR5 and of moves between files
# Each needs Python 3.11 or newer and a package index; everything goes into .venv, and no more than it needs.

PYTHON ?= python3
BIN := .venv/bin
# what is never imported need not be compiled: a third of the time
INSTALL := PIP_CONSTRAINT=constraints.txt $(BIN)/python -m pip install --quiet --no-compile --disable-pip-version-check
# what is imported is compiled once: tests start hundreds of processes, each three times faster then
export PYTHONDONTWRITEBYTECODE :=

# the processes of pytest share the cores; threads of linear algebra would wait for each other. Each
# starts with half of the tests, so that the models of a file are made once, and takes from the others
PYTEST := OPENBLAS_NUM_THREADS=1 $(BIN)/python -m pytest --numprocesses auto --dist worksteal
# kernels of linear algebra, those that this processor has: results must not depend on them
has = $(shell grep -m 1 -o $(1) /proc/cpuinfo 2>/dev/null)
KERNELS := Prescott $(if $(call has,avx2),Haswell) $(if $(call has,avx512f),SkylakeX)

.PHONY: run test test-long attack mutants docs bench clean

run: .venv/run
	mkdir -p out
	$(BIN)/mbdlft linearize scenarios/two_link_arm.toml -o out/two_link_arm.h5 --plot out/two_link_arm.png

test: .venv/test
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/lint-imports --no-cache
	$(PYTEST)

test-long: .venv/test .venv/docs mutants
	$(PYTEST) -m long
	for kernel in $(KERNELS); do OPENBLAS_CORETYPE=$$kernel $(PYTEST) || exit 1; done
	$(BIN)/python -m tests.attack --minutes 20 --seed 1000

mutants: .venv/test
	$(BIN)/python -m tests.mutants

attack: .venv/test
	$(BIN)/python -m tests.attack $(ATTACK)

docs: .venv/docs
	$(BIN)/python -m docs.site out/site

bench: .venv/bench
	$(BIN)/python -m benchmarks.arm --write docs/measured.md
	$(BIN)/python -m benchmarks.orders --write docs/orders.md
	$(BIN)/python -m benchmarks.flexible --write docs/flexible.md
	$(BIN)/python -m benchmarks.hard_cases --write docs/hard-cases.md
	$(BIN)/python -m benchmarks.scaling --write docs/scaling.md --figure docs/scaling.png
	XLA_FLAGS="--xla_cpu_multi_thread_eigen=false" $(BIN)/python -m benchmarks.speed_error --write docs/speed-error.md --figure docs/speed-error.png
	$(BIN)/python -m benchmarks.needs --write docs/needs.md
	$(BIN)/python -m benchmarks.scenarios --write docs/scenarios.md
	$(BIN)/python -m benchmarks.margins --write docs/analysis.md
	$(BIN)/python -m benchmarks.ur5
	$(BIN)/python -m benchmarks.equations
	$(BIN)/python -m benchmarks.moves

# what the package itself needs
.venv/run: pyproject.toml constraints.txt
	$(PYTHON) -m venv .venv
	$(INSTALL) -e '.[viewer]'
	touch $@

# what it is checked with, robots and other tools among them
.venv/test: .venv/run
	$(INSTALL) -e '.[test,robots,viewer,modelica]'
	touch $@

# other tools that speed and error are compared with
.venv/bench: .venv/test
	$(INSTALL) -e '.[benchmarks]'
	touch $@

# what makes web pages of docs/
.venv/docs: .venv/run
	$(INSTALL) -e '.[docs,viewer]'
	touch $@

clean:
	rm -rf .venv out
