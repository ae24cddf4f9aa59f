# `make demo` and `make test` do all their own set-up; a second run starts at once.

SHELL := /bin/bash
.SHELLFLAGS := -eu -o pipefail -c
.ONESHELL:
.DEFAULT_GOAL := help

PYTHONS := python3 python3.12 python3.11 python3.13
KERNELS := $(wildcard schemas/*.py vantage/*.py vantage/world/*.py vantage/perception/*.py vantage/networks/*.py vantage/tracking/*.py vantage/rehearsal/*.py services/seeker/*.py services/planner/*.py learning/hiders/*.py learning/roll_outs/*.py)

.PHONY: help demo reproduce test setup clean

help:
	@echo "make demo    set up, then let two robots play one game of hide-and-seek and draw it"
	@echo "make test    set up, then run the whole test suite"
	@echo "make reproduce PRESET=quick|hours|paper    set up, then redo the paper's study; its page is reproduction/PRESET/results.md"
	@echo "make setup   only set up (.venv with everything, developers' tools included)"
	@echo "make clean   remove .venv, logs and the demo's results"

demo: .venv/demo.installed .venv/kernels.compiled
	@.venv/bin/vantage demo

# PRESET=quick (half an hour on two cores), hours or paper; run again, it goes on where it stopped.
PRESET ?= quick
reproduce: .venv/demo.installed .venv/kernels.compiled
	@.venv/bin/vantage reproduce --preset $(PRESET) $(OPTIONS)

# Tests that start whole deployments wait more than they compute; they come after the others, so that all cores are theirs.
test: .venv/test.installed .venv/chromium.installed .venv/kernels.compiled
	@status=0
	.venv/bin/python -m pytest tests -m "not stack" -n 2 --dist loadfile || status=$$?
	.venv/bin/python -m pytest tests -m stack -n 2 --dist loadfile || status=$$?
	exit $$status

setup: .venv/test.installed .venv/chromium.installed .venv/kernels.compiled

clean:
	@rm -rf .venv logs demo

.venv/bin/python:
	@good() { command -v "$$1" > /dev/null && "$$1" -c 'import sys, venv, ensurepip; sys.exit(sys.version_info < (3, 11))' 2> /dev/null; }
	find_python() { for python in $(PYTHONS); do if good "$$python"; then echo "$$python"; return; fi; done; }
	python=$$(find_python)
	if [ -z "$$python" ]; then
		apt=apt-get
		[ "$$(id -u)" = 0 ] || apt="sudo -n apt-get"
		echo "== Python 3.11 or newer with venv is missing: asking apt for it"
		export DEBIAN_FRONTEND=noninteractive
		{ $$apt update -q && $$apt install -q -y --no-install-recommends python3 python3-venv; } > /tmp/vantage-apt-$$$$.log 2>&1 || true
		python=$$(find_python)
	fi
	if [ -z "$$python" ]; then
		echo "Vantage needs Python 3.11 or newer with its venv module, and could not install it itself." >&2
		echo "As root: apt-get install python3 python3-venv, then run make again." >&2
		exit 1
	fi
	echo "== making .venv with $$($$python --version)"
	$$python -m venv .venv

# $(1): extras. pip's chatter goes to .venv/install.log; one line a package is shown.
define install
	@pip() { .venv/bin/python -m pip --disable-pip-version-check --no-input install --constraint constraints.txt "$$@"; }
	narrate() {
		awk '{ print >> ".venv/install.log"; fflush() }
			/^ *(Downloading|Using cached) .*\([0-9.]+ [MG]B\)/ { name = $$(NF - 2); sub(/.*\//, "", name); sub(/-[0-9].*/, "", name)
				size = $$0; sub(/.*\(/, "(", size); print "   " name " " size; fflush() }
			/^Installing collected/ { print "   unpacking"; fflush() }
			/^ERROR/ { print; fflush() }'
	}
	echo "== installing what constraints.txt pins for: $(1) (some minutes the first time; details in .venv/install.log)"
	: > .venv/install.log
	failed() { tail -n 15 .venv/install.log >&2; echo "The installation failed; the whole log is .venv/install.log" >&2; exit 1; }
	pip hatchling editables 2>&1 | narrate || failed
	pip --no-build-isolation $(2) --editable ".[$(1)]" 2>&1 | narrate || failed
	touch $@
endef

.venv/demo.installed: pyproject.toml constraints.txt | .venv/bin/python
	$(call install,learning$(comma)console,torch==2.13.0)

.venv/test.installed: pyproject.toml constraints.txt | .venv/bin/python
	$(call install,learning$(comma)console$(comma)tracker$(comma)viewers$(comma)development,torch==2.13.0)
	touch .venv/demo.installed

# The console's page is tested in a real browser.
.venv/chromium.installed: | .venv/bin/python
	@if ! command -v chromium > /dev/null; then
		echo "== Chromium is missing, which the tests of the console's page drive: asking apt for it"
		apt=apt-get
		[ "$$(id -u)" = 0 ] || apt="sudo -n apt-get"
		export DEBIAN_FRONTEND=noninteractive
		{ $$apt update -q && $$apt install -q -y --no-install-recommends chromium; } > .venv/apt.log 2>&1 || true
	fi
	if ! command -v chromium > /dev/null; then
		echo "The tests need Chromium, and it could not be installed (see .venv/apt.log). As root: apt-get install chromium" >&2
		exit 1
	fi
	touch $@

.venv/kernels.compiled: $(KERNELS) | .venv/bin/python
	@echo "== compiling the kernels"
	.venv/bin/python -m vantage.warm_up
	touch $@

comma := ,
