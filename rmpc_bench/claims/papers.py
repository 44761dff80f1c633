"""Where the papers of the published configurations can be found."""

from __future__ import annotations

from collections.abc import Mapping

IDENTIFIERS: Mapping[str, str] = {
    "zenere2017": "arXiv:1703.05219",
    "zenere2018": "arXiv:1804.06746",
    "souto2011": "ISBN 978-953-307-200-5",
}
"""Key of a paper -> DOI, arXiv number or ISBN; of papers that are not named here none is known to us."""
