"""What is shown of a fit. Imported by module, so that each costs only what it needs:

table        fit.json, summary.csv and the table in the terminal (standard library only)
colour       the colours of signed distances (numpy)
dimensions   finished dimensions and how uncertain they are (numpy, torch)
mesh         cup and points as PLY, OBJ, GLB, and as one mesh to look at (numpy)
canvas, view, pictures  pictures of patterns and fits, as PNG (pillow)
page         web pages, with band and paper for what they show (scipy)
figures      drawings of cups and patterns as papers show them (matplotlib)
tensorboard  a batch's course as TensorBoard events (tensorboard)
"""
