"""The practical strategies of the paper, each with its trade measured  [Sensors, section 4.3]."""
