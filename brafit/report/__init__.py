"""What is shown of a fit. Imported by module, so that each costs only what it needs:

row, table   a scan's row; fit.json, summary.csv and the table in the terminal (standard library, numpy)
colour       the colours of signed distances (numpy)
dimensions   finished dimensions and how uncertain they are, with measures over the surface (numpy, torch)
uncovered    the share of a cup without data (scipy)
cup_writers  which files of the cup in 3D are written, and by what
mesh         cup and points as PLY, OBJ, GLB, and as one mesh to look at (numpy); stitches: what is sewn to what
canvas, view, pictures, inspection  pictures of patterns, fits and scans, as PNG (pillow; inspection: matplotlib)
html         what pages have in common; page: one scan's, with band and paper; index: the page over a run (scipy)
figures      matplotlib figures in files (matplotlib)
tensorboard  a batch's course as TensorBoard events (tensorboard); course: the same as plain numbers
"""
