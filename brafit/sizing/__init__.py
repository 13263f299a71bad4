"""Sizes from a population of fitted cups, and nests of patterns.

stored    fits as their folders keep them, and cups and patterns made of them again
surface   cups as points at corresponding places
distance  how far two cups are apart after a rigid motion, for all pairs
medoids   the k cups that serve all others best
cloth     which cups may be compared, and which pieces are cut alike
service   who is served how well, and the same by the wire alone
nest      patterns of several sizes, laid on one another
drawing   a nest as SVG, DXF and PDF
rows, picture, page  tables, pictures and the page of sizes
"""
