"""Tests of evenly spaced choices."""

from deblur_avatar.geometry.spacing import evenly_spaced


def test_first_and_last_are_among_an_even_choice():
    assert evenly_spaced(range(10), 4) == [0, 3, 6, 9]
    assert evenly_spaced("ab", 4) == ["a", "b"]
    assert evenly_spaced([], 4) == []
