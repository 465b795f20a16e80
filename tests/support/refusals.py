"""What is refused: the call, and words of what is said, of where, and of how to put it right."""

from collections.abc import Callable

import pytest

from exact_mdp import ModelError


def refused(call: Callable[[], object], *said: str) -> ModelError:
    """Assert that a call is refused, in these words of what, where and fix; return the error."""
    with pytest.raises(ModelError) as caught:
        call()
    error = caught.value
    for words, text in zip(said, (error.what, error.where, error.fix), strict=False):
        assert words in text
    assert error.fix
    return error
