# Two commands matter: `make book` and `make test`. `make` alone lists them all.
PYTHON ?= python3
PORT ?= 8000
SITE ?= build/rhl-book.tar.gz
TESTS ?=

SHELL := bash
.SHELLFLAGS := -eu -o pipefail -c
.DELETE_ON_ERROR:
.DEFAULT_GOAL := help

BIN := .venv/bin
export PATH := $(CURDIR)/$(BIN):$(PATH)

.PHONY: help env book test test-all mutants serve site pdf epub verify proofs bench campaign repeatable elsewhere clean-room audit lock clean

help: ## list these commands
	@sed -n 's/^\([a-z-]*\):.*## \(.*\)/make \1	\2/p' Makefile | expand -t 18

env: .venv/compiled ## make .venv with everything in environment.lock, and rhl on its path, its loops compiled

book: env ## execute and build the book into build/_build/html
	python tools/engine.py
	RHL_BOOK=1 python tools/fresh.py sh -c 'python -m tools.execute && jupyter-book build . --path-output build -W --keep-going'

test: env ## lint, types, library, notebooks, README and the book
	ruff check
	ruff format --check
	mypy
	pytest -n 3 --dist worksteal

test-all: env ## the same with large sizes: more random cases, every page in both themes, notebooks anew; for the night
	RHL_NIGHTLY=1 pytest -n 3 --dist worksteal -m "nightly or not nightly"

mutants: env ## change the library in 300 places and see which changes the tests, the claims and the notebooks notice
	python -m tools.mutants tests --at-least 0.92
	python -m tools.mutants verify --at-least 0.4
	python -m tools.mutants notebooks --at-least 0.8

serve: env ## show the built book on http://localhost:8000 (PORT=... for another port)
	@test -f build/_build/html/index.html || { echo "there is no book yet: type 'make book' first"; exit 1; }
	python -m http.server $(PORT) --bind localhost --directory build/_build/html

site: env ## pack the built book into one file that opens from any local server: build/rhl-book.tar.gz (SITE=... for another)
	@test -f build/_build/html/index.html || { echo "there is no book yet: type 'make book' first"; exit 1; }
	tar --create --gzip --file "$(SITE)" --directory build/_build --transform 's,^html,rhl-book,' html
	@ls -sh "$(SITE)"

pdf: env ## print the built book into build/rhl-book.pdf, with Debian's Chromium
	python tools/print.py build/rhl-book.pdf

epub: env ## make an EPUB of the built book: build/rhl-book.epub
	RHL_BOOK=1 python tools/epub.py build/rhl-book.epub

verify: env ## every claim of the paper, and both simulations against its published data
	rhl reproduce linear
	rhl reproduce robot
	rhl verify

proofs: ## have Coq check the theorems of proofs/ and say what they rest on; needs Debian's coq, libcoq-mathcomp-algebra
	@$(PYTHON) tools/proofs.py

bench: env ## measure how fast the library is
	pytest benchmarks --benchmark-only

campaign: env ## run the campaigns behind the page on many plants anew, or go on with them, about 10 minutes
	OPENBLAS_NUM_THREADS=1 python tools/campaign.py build/campaign --workers 2

repeatable: env ## build the committed book twice, in two folders, and compare the sites byte by byte
	python tools/repeatable.py build/repeatable

elsewhere: env ## compute the numbers with other threads, BLAS kernels, versions of packages and of Python (TESTS=--tests adds tests)
	python tools/elsewhere.py $(TESTS)

clean-room: env ## build the package, install it into empty environments, and try its commands and notebooks there
	python tools/clean_room.py --notebooks all

audit: env ## ask for known weaknesses of every package that environment.lock pins; needs the advisory service of PyPI
	uv tool run --from pip-audit==2.10.1 pip-audit --requirement environment.lock --require-hashes --disable-pip --strict

lock: $(BIN)/uv ## resolve pyproject.toml anew into environment.lock
	$(BIN)/python tools/lock.py $(BIN)/uv

clean: ## remove what was built; .venv stays
	rm -rf build dist .benchmarks .hypothesis .mypy_cache .pytest_cache .ruff_cache

# uv itself comes out of the lock, hashes required; then uv installs the rest of it.
$(BIN)/uv:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "rhl needs Python 3.11 or newer, this is " + sys.version.split()[0] + "; name another one, as in: make env PYTHON=python3.12")'
	$(PYTHON) -m venv --clear .venv
	$(BIN)/python -m pip install --quiet --require-hashes --requirement <(awk '/^[^ ]/ {mine = /^uv==/} mine' environment.lock)

.venv/installed: environment.lock pyproject.toml | $(BIN)/uv
	$(BIN)/uv pip sync --quiet --compile-bytecode --python $(BIN)/python --require-hashes --no-build environment.lock
	$(BIN)/uv pip install --quiet --python $(BIN)/python --no-deps --no-build-isolation --editable .
	touch $@

.venv/compiled: .venv/installed $(wildcard rhl/kernels/*.py)
	$(BIN)/python -m rhl.kernels
	touch $@
