"""What is shown of a fit. Imported by module, so that each costs only what it needs:

table        fit.json, summary.csv and the table in the terminal (standard library only)
colour       the colours of signed distances (numpy)
mesh         cup and points as PLY (numpy)
figures      drawings of patterns, fits and cups (matplotlib)
tensorboard  a batch's course as TensorBoard events (tensorboard)
"""
