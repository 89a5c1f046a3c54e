# Shortcuts to tasks.py, which does the work and needs no make.
PYTHON ?= python3

.PHONY: demo reproduce test prove lint benchmark clean
demo reproduce test prove lint benchmark clean:
	$(PYTHON) tasks.py $@ $(ARGS)
