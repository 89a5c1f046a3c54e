"""
Every example of the papers, run again: its figures, and a table beside what is printed.

[TM] B. Balaji, "Feynman path integrals and continuous-discrete filtering: the additive noise
case", DRDC Ottawa TM 2008-343; [Sensors] B. Balaji, "Continuous-discrete path integral filtering",
2009; [PMC] B. Balaji, "Universal nonlinear filtering using Feynman path integrals II: the
continuous-continuous model with additive noise", PMC Physics A, 2009.
"""
