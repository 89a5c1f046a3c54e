"""The examples of the papers, one module each: its settings, its data, what is printed."""
