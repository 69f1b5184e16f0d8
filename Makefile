# Everything this makes stays in the checkout: .venv, build, install, log, runs and docs/_build.
# PYTHON=python3.12 chooses the Python of a new .venv; PYTEST="-k demo -x" goes to pytest,
# BENCHMARKS="--only motion --cases A1" to the benchmarks.
.PHONY: help setup demo reproduce test test-all benchmarks docs lock clean
export PYTHON

help:
	@echo 'make demo    simulate, record and analyse the 3-star formation; results in runs/demo/'
	@echo 'make reproduce  the paper, figure by figure; results in runs/reproduction/ and runs/literature/'
	@echo 'make test    run every test but the long ones, which make test-all runs, too'
	@echo 'make benchmarks  measure against public solvers; results in runs/benchmarks/'
	@echo 'make docs    build the documentation; open docs/_build/html/index.html'
	@echo 'make setup   only make the workspace; then `. ./activate` puts it into a shell'
	@echo 'make lock    resolve the lock files in requirements/ anew (needs uv)'
	@echo 'make clean   remove all of it but runs/'

setup:
	@setup_tools/setup make

demo: setup
	@. ./activate && echo 'tss_ros: loading the demo' && exec ros2 run tss_ros demo

reproduce: setup
	@. ./activate && ros2 run tss_ros reproduce && ros2 run tss_ros literature && exec ros2 run tss_ros feedback

test: setup
	@. ./activate && exec python -m pytest -n auto --dist loadfile -m "not long" $(PYTEST)

test-all: setup
	@. ./activate && exec python -m pytest -n auto --dist loadfile $(PYTEST)

benchmarks: setup
	@. ./activate && exec python -m benchmarks $(BENCHMARKS)

docs: setup
	@. ./activate && exec python docs/build.py

UV = uv pip compile --quiet --upgrade --universal --python-version 3.10 --no-annotate \
	--no-emit-index-url --custom-compile-command 'make lock'
lock:
	$(UV) setup.py --extra test --extra dev --extra all -o requirements/python.txt
	$(UV) requirements/ros.in -c requirements/python.txt -o requirements/ros.txt
	$(UV) requirements/benchmarks.in -c requirements/python.txt -o requirements/benchmarks.txt
	# Sphinx bears older versions of these two only, and comes into a folder of its own
	grep -vE '^(docutils|markdown-it-py)==' requirements/python.txt | \
		$(UV) setup.py --extra docs -c - -o requirements/docs.txt

clean:
	rm -rf .venv .venv-benchmarks .docs-packages build install log
	rm -rf docs/_build docs/_generated docs/gallery
