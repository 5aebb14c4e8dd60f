"""Several looks at one grasp: what they say together."""

from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest

from fungrasp.core.errors import FungraspError
from fungrasp.perception.object_pose.confidence import ACCEPT
from fungrasp.perception.several_looks import best_of_looks, together
from fungrasp.perception.verdict import PerceptionVerdict


@dataclass(frozen=True)
class Look:
    """The part of a ``Perceived`` that counts here."""

    verdict: PerceptionVerdict
    name: str = ""

    @property
    def confident(self) -> bool:
        return self.verdict.sure


def look(probability: float, name: str = "", hand: float = 0.9) -> Look:
    """A look without doubts, whose object is so probable."""
    return Look(PerceptionVerdict(probability >= ACCEPT, probability, hand, (), ()), name)


def test_looks_that_are_sure_are_sure_together_and_not_surer():
    both = together([look(0.95), look(0.97, "second")])
    assert 0.95 < both.verdict.object < 0.97 and both.verdict.sure and both.verdict.looks == 2
    assert both.name == "second", "the answer is that of the surest look"
    assert "2 looks" in both.verdict.words
    assert together([look(0.9), look(0.9), look(0.9)]).verdict.object == pytest.approx(0.9)


def test_a_look_that_says_no_counts_against():
    assert together([look(0.92), look(0.1)]).verdict.object < 0.6
    unsure = look(0.5)
    unsure = replace(unsure, verdict=replace(unsure.verdict, help=("another view",)))
    assert together([look(0.97), unsure]).verdict.help == ("another view",), "the sure one has no advice"
    # One look can't decide alone, however sure it is.
    assert not together([look(1.0), look(0.1), look(0.0)]).verdict.sure


def test_a_look_that_may_not_be_used_is_not_the_answer_where_another_is_sure():
    cut = look(0.97)
    cut = replace(cut, verdict=replace(cut.verdict, sure=False, doubt="the hand is cut off at the top edge"))
    both = together([cut, look(0.96, "whole")])
    assert both.verdict.sure and not both.verdict.doubt and both.name == "whole"
    assert not together([cut, look(0.96, hand=0.3)]).verdict.sure


def images(*probabilities: float) -> list[SimpleNamespace]:
    """Captures that differ where what is said of them does."""
    return [SimpleNamespace(said=p, color=np.full((2, 2, 3), p)) for p in probabilities]


def test_no_further_look_where_one_is_sure():
    seen = []

    def perceived(capture):
        seen.append(capture.said)
        return look(capture.said)

    said = []
    assert best_of_looks(images(0.98, 0.2), perceived, 2, said.append).verdict.looks == 1 and seen == [0.98]
    seen.clear()
    assert best_of_looks(images(0.8, 0.85), perceived, 2, said.append).verdict.looks == 2
    assert [one.verdict.object for one in said] == [0.8], "asked for another look once"
    seen.clear()
    assert best_of_looks(images(0.8, 0.85, 0.1), perceived, 2).verdict.object == pytest.approx(0.83, abs=0.01)
    assert seen == [0.8, 0.85], "no more than two were wanted"
    assert best_of_looks(images(0.6), perceived, 5).verdict == look(0.6).verdict
    weak = [replace(look(0.98), verdict=replace(look(0.98).verdict, hand=0.2, sure=False)) for _ in range(2)]
    assert not together(weak).verdict.sure, "the hand is not"


def test_an_image_that_was_looked_at_already_says_nothing_new():
    said = best_of_looks(images(0.9, 0.9, 0.9), lambda capture: look(capture.said), 3).verdict
    assert said == look(0.9).verdict and said.looks == 1


def test_an_image_without_a_hand_does_not_take_the_answer_of_others_away():
    def perceived(capture):
        if capture.said == 0.5:
            raise FungraspError("no hand found")
        return look(capture.said)

    assert best_of_looks(images(0.8, 0.5, 0.85), perceived, 3).verdict.looks == 2
    assert best_of_looks(images(0.5, 0.8, 0.85), perceived, 3).verdict.looks == 2
    with pytest.raises(FungraspError, match="no hand"):
        best_of_looks(images(0.5), perceived, 3)
