"""Where the papers of the published configurations can be found."""

from __future__ import annotations

import re
from collections.abc import Mapping

IDENTIFIERS: Mapping[str, str] = {
    "zenere2017": "arXiv:1703.05219",
    "zenere2018": "arXiv:1804.06746",
    "souto2011": "ISBN 978-953-307-200-5",
    "wkf2018": "arXiv:1809.08830",
}
"""Key of a paper -> DOI, arXiv number or ISBN; of papers that are not named here none is known to us."""
_WITH_YEAR = re.compile(r".*\d{4}[a-z]?")


def usual_parameters(paper: str | None) -> str:
    """Say where parameters come from that are neither tuned nor described in the configuration.

    Parameters
    ----------
    paper : of the configuration; the key of a publication ends with its year, any other names a collection

    Examples
    --------
    >>> usual_parameters("zenere2018"), usual_parameters("examples"), usual_parameters(None)
    ('as published', 'default', 'default')
    """
    return "as published" if paper is not None and _WITH_YEAR.fullmatch(paper) else "default"
