"""`clbvh fetch`, against a server on this machine: complete downloads, damaged ones, and refusals."""

from __future__ import annotations

import hashlib
import io
import tarfile
import threading
from collections.abc import Iterator
from dataclasses import dataclass, replace
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest

from clbvh.cli.app import run
from clbvh.errors import ConfigError, FetchError
from clbvh.geometry.fetch import KNOWN_MESHES, fetch_mesh, find_known_mesh

MESH = b"ply\nthe bunny\n" + bytes(range(256)) * 2000


def make_archive(members: dict[str, bytes], *, kind: bytes = tarfile.REGTYPE) -> bytes:
    """Make a tar.gz; every member but regular files links to `/etc/passwd`."""
    out = io.BytesIO()
    with tarfile.open(fileobj=out, mode="w:gz", compresslevel=1) as tar:
        for name, content in members.items():
            info = tarfile.TarInfo(name)
            info.type = kind
            info.linkname = "" if kind == tarfile.REGTYPE else "/etc/passwd"
            info.size = len(content) if kind == tarfile.REGTYPE else 0
            tar.addfile(info, io.BytesIO(content))
    return out.getvalue()


@dataclass
class Site:
    """The files of the server, and the requests it got."""

    url: str
    files: dict[str, bytes]
    asked: list[str]
    sent_share: float = 1.0  # of each file, before the connection is cut


@pytest.fixture
def site(monkeypatch) -> Iterator[Site]:
    monkeypatch.setenv("NO_PROXY", "127.0.0.1")

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            site.asked.append(self.path)
            content = site.files.get(self.path)
            if content is None:
                self.send_error(404)
                return
            self.send_response(200)
            self.send_header("Content-Length", str(len(content)))
            self.end_headers()
            self.wfile.write(content[: int(len(content) * site.sent_share)])

        def log_message(self, *_: object) -> None:
            """Say nothing."""

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    site = Site(f"http://127.0.0.1:{server.server_port}/pub", {}, [])
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
    thread.start()
    yield site
    server.shutdown()
    thread.join()
    server.server_close()


@pytest.fixture
def cache(tmp_path, monkeypatch) -> Path:
    folder = tmp_path / "deep" / "cache"
    monkeypatch.setenv("CLBVH_CACHE", str(folder))
    monkeypatch.delenv("CLBVH_MESHES", raising=False)
    return folder


def offer(site: Site, monkeypatch, name: str, archive: bytes, *, mesh: bytes = MESH) -> None:
    """Put an archive on the server, and its sum, or for the drill the mesh's, into the table."""
    known = KNOWN_MESHES[name]
    site.files[f"/pub/{known.archive}"] = archive
    if known.archive_sha256:
        known = replace(known, archive_sha256=hashlib.sha256(archive).hexdigest())
    else:
        known = replace(known, member_sha256=hashlib.sha256(mesh).hexdigest())
    monkeypatch.setitem(KNOWN_MESHES, name, known)


def clbvh(*words: str) -> int:
    """Run a command; return its exit code."""
    with pytest.raises(SystemExit) as caught:
        run(list(words))
    return int(caught.value.code or 0)


def names_below(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.rglob("*")) if folder.exists() else []


@pytest.mark.parametrize("name", KNOWN_MESHES)
def test_fetch_puts_the_mesh_into_the_cache(site, cache, monkeypatch, capsys, name):
    known = KNOWN_MESHES[name]
    offer(site, monkeypatch, name, make_archive({"README": b"hello", known.member: MESH, "../../evil": b"evil"}))
    assert clbvh("fetch", name, "--base-url", site.url) == 0
    assert (cache / known.file_name).read_bytes() == MESH
    assert names_below(cache.parent.parent) == sorted(["deep", "cache", known.file_name])
    output = capsys.readouterr()
    assert str(cache / known.file_name) in output.out
    assert output.err == ""
    assert find_known_mesh(name) == cache / known.file_name

    # A second time, nothing is asked of the server.
    assert clbvh("fetch", name, "--base-url", site.url) == 0
    assert site.asked == [f"/pub/{known.archive}"]


def test_a_mesh_of_the_user_s_folder_is_not_fetched(site, cache, monkeypatch, capsys, tmp_path):
    (tmp_path / "meshes").mkdir()
    (tmp_path / "meshes" / "dragon_871k.ply").touch()
    monkeypatch.setenv("CLBVH_MESHES", str(tmp_path / "meshes"))
    assert clbvh("fetch", "dragon", "--base-url", site.url) == 0
    assert capsys.readouterr().out.split() == ["dragon", str(tmp_path / "meshes" / "dragon_871k.ply")]
    assert (site.asked, names_below(cache)) == ([], [])


def test_fetch_several(site, cache, monkeypatch):
    for name in ("bunny", "drill"):
        offer(site, monkeypatch, name, make_archive({KNOWN_MESHES[name].member: MESH}))
    assert clbvh("fetch", "bunny", "drill", "--base-url", site.url + "/") == 0
    assert names_below(cache) == ["bun_zipper.ply", "drill_shaft_zip.ply"]


@pytest.mark.parametrize("name", KNOWN_MESHES)
def test_a_wrong_sum_deletes_the_file_and_fails(site, cache, capsys, name):
    known = KNOWN_MESHES[name]  # with its real sum, which is not that of this archive
    site.files[f"/pub/{known.archive}"] = make_archive({known.member: MESH})
    assert clbvh("fetch", name, "--base-url", site.url) == 1
    assert names_below(cache) == []
    output = capsys.readouterr()
    assert output.out == ""
    assert len(output.err.splitlines()) == 1
    assert "damaged on its way" in output.err
    assert (known.archive_sha256 or known.member_sha256) in output.err


@pytest.mark.parametrize("name", ["bunny", "drill"])
@pytest.mark.parametrize("share", [0.0, 0.5, 0.999])
def test_a_cut_connection_fails_and_leaves_nothing(site, cache, monkeypatch, capsys, name, share):
    offer(site, monkeypatch, name, make_archive({KNOWN_MESHES[name].member: MESH}))
    site.sent_share = share
    assert clbvh("fetch", name, "--base-url", site.url) == 1
    assert names_below(cache) == []
    error = capsys.readouterr().err
    assert len(error.splitlines()) == 1
    assert site.url in error


def test_an_archive_that_was_cut_before_it_was_offered_is_found_out(site, cache, monkeypatch):
    whole = make_archive({KNOWN_MESHES["drill"].member: MESH})
    for end in (0, 10, len(whole) // 2, len(whole) * 9 // 10):
        offer(site, monkeypatch, "drill", whole[:end])
        with pytest.raises(FetchError, match="the archive is damaged or was cut off"):
            fetch_mesh("drill", base_url=site.url)
        assert names_below(cache) == []


@pytest.mark.parametrize(
    ("archive", "message"),
    [
        pytest.param(make_archive({"other.ply": MESH}), "the archive has no 'bunny/", id="no-member"),
        pytest.param(b"not an archive", "the archive is damaged", id="no-archive"),
        pytest.param(
            make_archive({KNOWN_MESHES["bunny"].member: b""}, kind=tarfile.SYMTYPE),
            "the archive has no 'bunny/",
            id="link",
        ),
        pytest.param(
            make_archive({KNOWN_MESHES["bunny"].member: b""}, kind=tarfile.DIRTYPE),
            "is not the known mesh",
            id="folder",
        ),
    ],
)
def test_an_archive_that_is_not_what_it_should_be(site, cache, monkeypatch, archive, message):
    offer(site, monkeypatch, "bunny", archive)
    with pytest.raises(FetchError, match=message):
        fetch_mesh("bunny", base_url=site.url)
    assert names_below(cache) == []


def test_no_such_file_on_the_server(site, cache, capsys):
    assert clbvh("fetch", "bunny", "--base-url", site.url) == 1
    assert "the server answers 404 Not Found" in capsys.readouterr().err
    assert names_below(cache) == []


def test_no_server(site, cache, capsys):
    assert clbvh("fetch", "bunny", "--base-url", "http://127.0.0.1:9/pub") == 1
    error = capsys.readouterr().err
    assert "the connection failed" in error
    assert len(error.splitlines()) == 1


def test_a_cache_that_cannot_be_made(site, tmp_path, monkeypatch, capsys):
    (tmp_path / "file").touch()
    monkeypatch.setenv("CLBVH_CACHE", str(tmp_path / "file"))
    monkeypatch.delenv("CLBVH_MESHES", raising=False)
    assert clbvh("fetch", "bunny", "--base-url", site.url) == 1
    assert f"cannot be stored in {tmp_path / 'file'}" in capsys.readouterr().err


def test_an_unknown_name_is_found_out_before_any_download(site, cache, monkeypatch, capsys):
    offer(site, monkeypatch, "bunny", make_archive({KNOWN_MESHES["bunny"].member: MESH}))
    assert clbvh("fetch", "bunny", "teapot", "--base-url", site.url) == 2
    assert "the known ones are bunny, dragon, drill" in capsys.readouterr().err
    assert site.asked == []
    with pytest.raises(ConfigError):
        fetch_mesh("teapot")


@pytest.mark.parametrize("words", [("fetch",), ("fetch", "--list")])
def test_the_list_says_what_is_known_and_where(cache, capsys, words):
    cache.mkdir(parents=True)
    (cache / "bun_zipper.ply").touch()
    assert clbvh(*words) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines] == ["bunny", "dragon", "drill"]
    assert lines[0].endswith(str(cache / "bun_zipper.ply"))
    assert "run 'clbvh fetch dragon'" in lines[1]


def test_the_bar_counts_the_bytes(site, cache, monkeypatch):
    class Bar:
        total, done, closed = 0, 0, False

        def update(self, byte_count: int) -> None:
            self.done += byte_count

        def reset(self) -> None:
            self.done = 0

        def close(self) -> None:
            self.closed = True

    archive = make_archive({KNOWN_MESHES["bunny"].member: MESH})
    offer(site, monkeypatch, "bunny", archive)
    bar = Bar()
    fetch_mesh("bunny", base_url=site.url, progress=bar)
    assert (bar.total, bar.done, bar.closed) == (len(archive), len(archive), True)
