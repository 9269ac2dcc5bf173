"""`clbvh study`: tiny experiments on one page."""

import pytest

from clbvh.study import scale

from .command import run_clbvh


@pytest.mark.usefixtures("_opened_device")
def test_experiments_join_on_one_page(tmp_path, monkeypatch):
    monkeypatch.setattr(scale, "QUICK", scale.TINY)
    answer = run_clbvh("study", "threshold", "--quick", "-o", tmp_path)
    assert answer.returncode == 0, answer.stderr
    names = ("index.html", "samples.jsonl", "samples.csv")
    assert answer.stdout.splitlines() == [str(tmp_path / name) for name in names]
    page = (tmp_path / "index.html").read_text()
    assert '<section id="threshold">' in page
    assert '<section id="ladder">' not in page
    assert run_clbvh("study", "divergence", "--quick", "-o", tmp_path).returncode == 0
    page = (tmp_path / "index.html").read_text()
    assert page.index('<section id="threshold">') < page.index('<section id="divergence">')
