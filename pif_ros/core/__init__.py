"""
The filter without ROS: grids, densities, kernels, filters, and the tracker that owns the time.

Symbols follow the papers: drift f, diffusion vielbein e, noise covariance Q, g = e Q e^T,
sensor h with covariance R.  An array of states has its components first, shape (n, ...), so that
a model reads ``x1, x2 = x``.  Sources are cited as
[TM] Balaji, DRDC Ottawa TM 2008-343; [Sensors] Balaji, Sensors 2009, 9(8), 6339-6360.
"""
