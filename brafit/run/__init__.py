"""From scans to results, for one scan or ten thousand. Knows no command line; `brafit.cli.fit` makes its `Job`.

dataset    what a run works on
recipe     how scans are loaded, fitted and finished
stages     the three of them, as calls that workers do
conductor  hands out the work, as a stream over worker processes
sinks      what becomes of it besides the scans' own folders
store      what is finished already
closing    what is said at the end
"""

from brafit.run.conductor import run
from brafit.run.job import Done, Job, Overview, Row

__all__ = ["Done", "Job", "Overview", "Row", "run"]
