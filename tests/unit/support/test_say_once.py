"""Sentences for the user: once, through `logging`, and on stderr where somebody waits."""

import logging

import pytest

from clbvh.support.say_once import say_compiling, say_once

LINE = "clbvh: compiling for this machine; `clbvh warmup` does it ahead\n"


@pytest.mark.parametrize(
    ("make_handlers", "of_any_sentence"),
    [(list, 1), (lambda: [logging.StreamHandler()], 1), (lambda: [logging.NullHandler()], 0)],
    ids=["not set up", "on stderr", "elsewhere"],
)
def test_a_reason_to_wait_is_on_stderr_once_however_the_program_logs(
    make_handlers, of_any_sentence, monkeypatch, capsys
):
    monkeypatch.setenv("_CLBVH_SAID", "")
    monkeypatch.setattr(logging.getLogger(), "handlers", make_handlers())
    for _ in range(2):
        say_compiling()
    assert capsys.readouterr().err == LINE
    say_once("a cache that cannot be used")
    assert len(capsys.readouterr().err.splitlines()) == of_any_sentence
