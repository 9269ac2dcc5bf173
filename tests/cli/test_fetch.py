"""`clbvh fetch`, against a server on this machine: complete downloads, damaged ones, and refusals."""

import hashlib
import io
import tarfile
import threading
from dataclasses import replace
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from types import SimpleNamespace

import pytest

from clbvh.geometry.fetch import KNOWN_MESHES, find_known_mesh

from .command import refuses, run_clbvh

MESH = b"ply\nthe bunny\n" + bytes(range(256)) * 2000


def make_archive(name: str, content: bytes = MESH, kind: bytes = tarfile.REGTYPE) -> bytes:
    """Make a tar.gz of a file and two others; every member but regular files links to `/etc/passwd`."""
    out = io.BytesIO()
    with tarfile.open(fileobj=out, mode="w:gz", compresslevel=1) as tar:
        for member, data in {"README": b"hello", name: content, "../../evil": b"evil"}.items():
            info = tarfile.TarInfo(member)
            info.type = kind if member == name else tarfile.REGTYPE
            is_file = info.type == tarfile.REGTYPE
            info.linkname, info.size = ("", len(data)) if is_file else ("/etc/passwd", 0)
            tar.addfile(info, io.BytesIO(data))
    return out.getvalue()


@pytest.fixture
def site(monkeypatch):
    """A server: its files, the requests it got, and the share of each file that it sends."""
    monkeypatch.setenv("NO_PROXY", "127.0.0.1")

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self):
            site.asked.append(self.path)
            content = site.files.get(self.path)
            if content is None:
                self.send_error(404)
                return
            self.send_response(200)
            self.send_header("Content-Length", str(len(content)))
            self.end_headers()
            self.wfile.write(content[: int(len(content) * site.sent_share)])

        def log_message(self, *_):
            """Say nothing."""

    with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        url = f"http://127.0.0.1:{server.server_port}/pub"
        site = SimpleNamespace(url=url, files={}, asked=[], sent_share=1.0)
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
        thread.start()
        yield site
        server.shutdown()
        thread.join()


@pytest.fixture
def cache(tmp_path, monkeypatch) -> Path:
    folder = tmp_path / "deep" / "cache"
    monkeypatch.setenv("CLBVH_CACHE", str(folder))
    monkeypatch.delenv("CLBVH_MESHES", raising=False)
    return folder


@pytest.fixture
def offer(site, monkeypatch):
    """A function that puts an archive on the server, and its sum, or for the drill the mesh's, into the table."""

    def put(name: str, archive: bytes | None = None) -> bytes:
        known = KNOWN_MESHES[name]
        archive = make_archive(known.member) if archive is None else archive
        site.files[f"/pub/{known.archive}"] = archive
        if known.archive_sha256:
            known = replace(known, archive_sha256=hashlib.sha256(archive).hexdigest())
        else:
            known = replace(known, member_sha256=hashlib.sha256(MESH).hexdigest())
        monkeypatch.setitem(KNOWN_MESHES, name, known)
        return archive

    return put


def fetch(site, *names):
    return run_clbvh("fetch", *names, "--base-url", site.url)


def names_below(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.rglob("*")) if folder.exists() else []


def test_meshes_are_put_into_the_cache_once(site, cache, offer):
    for name in KNOWN_MESHES:
        offer(name)
    answer = fetch(site, *KNOWN_MESHES)
    assert (answer.returncode, answer.stderr) == (0, "")
    for name, known in KNOWN_MESHES.items():
        assert (cache / known.file_name).read_bytes() == MESH
        assert str(cache / known.file_name) in answer.stdout
        assert find_known_mesh(name) == cache / known.file_name
    assert len(names_below(cache)) == len(KNOWN_MESHES)
    # A second time, nothing is asked of the server.
    assert fetch(site, *KNOWN_MESHES).returncode == 0
    assert site.asked == [f"/pub/{known.archive}" for known in KNOWN_MESHES.values()]


def test_a_wrong_sum_fails_and_leaves_nothing(site, cache):
    for name, known in KNOWN_MESHES.items():  # with its real sum, which is not that of this archive
        site.files[f"/pub/{known.archive}"] = make_archive(known.member)
        refuses(fetch(site, name), 1, "damaged on its way", known.archive_sha256 or known.member_sha256)
        assert names_below(cache) == []


def test_an_archive_that_is_not_what_it_should_be_is_found_out(site, cache, offer):
    member = KNOWN_MESHES["bunny"].member
    whole = make_archive(KNOWN_MESHES["drill"].member)
    damaged = "the archive is damaged"
    archives = [
        ("bunny", make_archive("other.ply"), "the archive has no 'bunny/"),
        ("bunny", b"not an archive", damaged),
        ("bunny", make_archive(member, kind=tarfile.SYMTYPE), "the archive has no 'bunny/"),
        ("bunny", make_archive(member, kind=tarfile.DIRTYPE), "is not the known mesh"),
        *(("drill", whole[: int(len(whole) * share)], damaged) for share in (0, 0.001, 0.5, 0.9)),
    ]
    for name, archive, said in archives:
        offer(name, archive)
        refuses(fetch(site, name), 1, said)
        assert names_below(cache) == []
    for site.sent_share in (0.0, 0.5, 0.999):
        refuses(fetch(site, "drill"), 1, site.url)
        assert names_below(cache) == []


def test_no_file_no_server_and_no_folder(site, cache, tmp_path):
    refuses(fetch(site, "bunny"), 1, "the server answers 404 Not Found")
    refuses(run_clbvh("fetch", "bunny", "--base-url", "http://127.0.0.1:9/pub"), 1, "the connection failed")
    (tmp_path / "file").touch()
    answer = run_clbvh("fetch", "bunny", "--base-url", site.url, CLBVH_CACHE=str(tmp_path / "file"))
    refuses(answer, 1, f"cannot be stored in {tmp_path / 'file'}")


def test_an_unknown_name_is_found_out_before_any_download(site, cache, offer):
    offer("bunny")
    refuses(fetch(site, "bunny", "teapot"), 2, "the known ones are bunny, dragon, drill")
    assert site.asked == []
