# Shortcuts to tasks.py, which does the work and needs no make.
PYTHON ?= python3

.PHONY: demo test lint benchmark clean
demo test lint benchmark clean:
	$(PYTHON) tasks.py $@ $(ARGS)
