"""The keys of a claim: what a statement of a paper may have, and the numbers that it names."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Any, Literal

from annotated_types import Gt, Lt
from pydantic import Field

from rmpc_bench.claims.claim import CLOSE, FINDINGS, MAX_QUOTED_WORDS, printed_number
from rmpc_bench.expressions.quantity import number as number_of
from rmpc_bench.received.names import EXPERIMENT
from rmpc_bench.types import NonNegative
from rmpc_bench.types.basics import Text

Name = Annotated[str, Field(pattern=EXPERIMENT)]
"""Name of an experiment, of a paper or of a statement."""


@dataclass(frozen=True)
class StatedKeys:
    """A number of the paper, which the expression `of` computes.

    With a `tolerance` it is a size of effect.  Without one it is a number without Monte Carlo error: the finding is
    ``equal``, ``close`` or ``different``.

    Parameters
    ----------
    of : expression in the language of claims, such as last(trace(P[KF]))
    value : the number of the paper; without a tolerance a text with the digits that the paper prints, such as '58.20'
    tolerance : absolute difference up to which the size of an effect is that of the paper
    text : the words of the paper about it
    close : largest relative difference that is called close
    """

    of: Text
    value: float | Text
    tolerance: NonNegative | None = None
    text: str = ""
    close: Annotated[float, Gt(0), Lt(1)] = CLOSE

    def __post_init__(self) -> None:
        """Refuse a number whose digits are not known, and words in place of one."""
        if self.tolerance is not None:
            object.__setattr__(self, "value", number_of(self.value))
        elif not isinstance(self.value, str):
            raise ValueError(f"without a tolerance value is the printed text, such as '{self.value:g}' in quotes")
        else:
            printed_number(self.value)


@dataclass(frozen=True)
class ClaimKeys:
    """One statement of a paper.

    Parameters
    ----------
    says : the statement, in our words
    source : section, figure or table of the paper; it begins with `additional result` for what the paper does not state
    id : name of the statement; claims with the same `id` in several configurations of a paper have a joined finding
    quote : the words of the paper, at most 25 of them
    check : a comparison in the language of claims, or a list of them; without one the claim is not testable
    holds_for : `all` if the check must hold at all points of `at`, `most` if at the majority of them, `any` if at one
    at : point of the sweep for all terms that name none, a list of interpretations, or `all`
    grounds : interpretation -> its ground in the text of the paper
    finding : the recorded finding; `--strict` exits with 1 where the computed one differs
    stated : numbers of the paper with which the computed ones are compared, or its words
    assumptions : what the paper leaves open and what we assume, one sentence each
    elsewhere : configuration -> its recorded finding of the statement with the same `id`
    figure : name of the figure in which a reader sees whether the statement holds, such as boxplot or signals-2
        for the second figure of this kind, or a list of names
    """

    says: Text
    source: str = ""
    id: Name | None = None
    quote: Text | None = None
    check: Text | list[Text] | None = None
    holds_for: Literal["all", "most", "any"] = "all"
    at: Any = None
    grounds: dict[str, Text] = field(default_factory=dict)
    finding: Literal[FINDINGS] | None = None  # type: ignore[valid-type]
    stated: Text | StatedKeys | list[StatedKeys] | None = None
    assumptions: list[Text] = field(default_factory=list)
    elsewhere: dict[Name, Literal[FINDINGS]] | None = None  # type: ignore[valid-type]
    figure: Text | list[Text] | None = None

    def __post_init__(self) -> None:
        """Refuse a quotation that is longer than what may be quoted."""
        n_words = len((self.quote or "").split())
        if n_words > MAX_QUOTED_WORDS:
            raise ValueError(f"quote must have at most {MAX_QUOTED_WORDS} words (got {n_words})")
