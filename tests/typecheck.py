"""The type checker that the tests put around every function of the package: beartype, with int allowed for float."""

from __future__ import annotations

from beartype import BeartypeConf, beartype

checked = beartype(conf=BeartypeConf(is_pep484_tower=True))
