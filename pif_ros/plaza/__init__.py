"""
A lawn mower seen by four range-only radios: a real recording, its player and its demonstration.

The recordings are Plaza1 and Plaza2 of J. Djugash, B. Hamner and S. Roth, "Navigating with
ranging radios: five data sets with ground truth", Journal of Field Robotics 26(9), 2009.
"""
