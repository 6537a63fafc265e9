"""Configuration: precedence, merging, includes, bounds and the words of its errors."""

from __future__ import annotations

import random
from contextlib import suppress
from pathlib import Path

import pytest
import yaml
from project import project

import dssmsg
from dssmsg.config import RunConfig, load_config, packaged_file
from dssmsg.config_errors import dotted_key
from dssmsg.config_layers import merge, origin, set_layers
from dssmsg.config_yaml import MAX_BYTES, parse_yaml
from dssmsg.errors import ConfigError

ROOT = Path(dssmsg.__file__).parents[1]


def load(
    path: Path | None = None, env: dict[str, str] | None = None, sets: tuple[str, ...] = ()
) -> RunConfig:
    return load_config(path, sets=sets, environment=env or {})


def refused(
    path: Path | None = None, env: dict[str, str] | None = None, sets: tuple[str, ...] = ()
) -> ConfigError:
    with pytest.raises(ConfigError) as caught:
        load(path, env, sets)
    return caught.value


def written(folder: Path, text: str, name: str = "my.yaml") -> Path:
    return project(folder, {name: text}).path / name


def test_packaged_file_is_the_canonical_one() -> None:
    assert packaged_file().read_bytes() == (ROOT / "dssmsg.yaml").read_bytes()


def test_default_names_a_plugin_for_every_place() -> None:
    config = load()
    assert {key: slot.use for key, slot in config.slots.items()} == {
        "source": "pybullet",
        "perception": "furniture",
        "encoder": "minilm",
        "llm": "lexicon",
        "association": "dssm",
        "update": "dssm",
        "grounding": "dssm",
        "navigation": "dijkstra",
        "recording.observers.rerun": "rerun",
    }
    assert config.mission.phases == ("survey", "revisit")
    assert config.mission.max_frames == 1200
    assert config.association.options == {"delta_sim": 1.1}


def test_every_arrow_of_the_precedence(tmp_path: Path) -> None:
    """default < included < file < environment < --set, each arrow on its own key and all on one."""
    written(tmp_path, "seed: 1\nname: included\ntimeout_secs: 5\n", "base.yaml")
    path = written(tmp_path, "include: base.yaml\nseed: 2\nname: file\n")
    assert load().seed == 0
    assert load(tmp_path / "base.yaml").seed == 1  # default < file
    assert load(path).timeout_secs == 5  # default < included
    assert load(path).seed == 2  # included < file
    assert load(path, {"DSSMSG__SEED": "3"}).seed == 3  # file < environment
    assert load(path, {"DSSMSG__SEED": "3"}, ("seed=4",)).seed == 4  # environment < --set
    assert load(path, {"DSSMSG__SEED": "3"}, ("seed=4", "seed=5")).seed == 5  # earlier < later --set
    assert load(path, {"DSSMSG__SEED": "3"}).name == "file"


def test_environment_reaches_nested_options() -> None:
    config = load(env={"DSSMSG__ASSOCIATION__DELTA_SIM": "1.4", "DSSMSG__RECORDING__DIRECTORY": "else"})
    assert (config.association.options["delta_sim"], config.recording.directory) == (1.4, "else")


def test_values_are_parsed_as_yaml() -> None:
    config = load(
        sets=("mission.phases=[survey]", "source.noise={blur: true, gain: 1e-3}", "source.scene='7'")
    )
    assert config.mission.phases == ("survey",)
    assert config.source.options["noise"] == {"blur": True, "gain": 0.001}
    assert config.source.options["scene"] == "7"


@pytest.mark.parametrize("layer", ["include", "environment", "set"])
def test_changing_use_drops_the_lower_options(tmp_path: Path, layer: str) -> None:
    base = written(tmp_path, "association: {use: dssm, delta_sim: 1.3}\n", "base.yaml")
    if layer == "include":
        config = load(written(tmp_path, "include: base.yaml\nassociation: {use: other, mine: 1}\n"))
        assert config.association.flat() == {"use": "other", "mine": 1}
        config = load(written(tmp_path, "include: base.yaml\nassociation: {use: dssm, more: 1}\n"))
        assert config.association.flat() == {"use": "dssm", "delta_sim": 1.3, "more": 1}
    elif layer == "environment":
        config = load(base, {"DSSMSG__ASSOCIATION__USE": "other"})
        assert config.association.flat() == {"use": "other"}
    else:
        assert load(base, sets=("association.use=other",)).association.flat() == {"use": "other"}
        config = load(base, sets=("association.use=dssm", "association.delta_sim=1.2"))
        assert config.association.flat() == {"use": "dssm", "delta_sim": 1.2}


def test_options_named_before_use_in_the_same_layer_stay(tmp_path: Path) -> None:
    config = load(written(tmp_path, "source: {path: here, use: rgbd}\n"))
    assert config.source.flat() == {"path": "here", "use": "rgbd"}


def test_nested_slots_drop_options_too() -> None:
    config = load(
        sets=(
            "perception={use: chain, segmenter: {use: depth, margin: 2}}",
            "perception.segmenter.use=sam",
        )
    )
    assert config.perception.options["segmenter"] == {"use": "sam"}


def test_observers_are_named_added_and_switched_off(tmp_path: Path) -> None:
    path = written(tmp_path, "recording: {observers: {jsonl: , rerun: {images: lossless}}}\n")
    assert {name: slot.flat() for name, slot in load(path).recording.observers.items()} == {
        "rerun": {"use": "rerun", "images": "lossless"},
        "jsonl": {"use": "jsonl"},
    }
    assert list(load(path, sets=("recording.observers.rerun=false",)).recording.observers) == ["jsonl"]
    other = load(path, sets=("recording.observers.rerun.use=mine.py:Writer",)).recording.observers["rerun"]
    assert set(other.flat()) == {"use"}


def test_resolved_yaml_loads_back_equal(tmp_path: Path) -> None:
    first = load(
        sets=(
            "name=again",
            "mission.goals=[a cup]",
            "mission.phases=[survey, seek]",
            "diagnosis=[{use: errors}]",
        )
    )
    second = load(written(tmp_path, first.resolved_yaml()))
    assert second.resolved() == first.resolved()


def test_configuration_is_frozen() -> None:
    config = load()
    with pytest.raises(ValueError, match="frozen"):
        config.seed = 3  # type: ignore[misc]
    with pytest.raises(TypeError):
        config.source.options["scene"] = "other"  # type: ignore[index]


def test_local_file_is_found(tmp_path: Path) -> None:
    folder = project(tmp_path, {"dssmsg.yaml": "seed: 11\n"})
    with folder.inside():
        config = load()
        assert (config.seed, config.base_dir, config.file) == (11, tmp_path.resolve(), Path("dssmsg.yaml"))


def test_relative_plugin_paths_start_at_the_file_that_names_them(tmp_path: Path) -> None:
    folder = project(
        tmp_path,
        {
            "sub/base.yaml": "plugins: [mine.py]\nperception: {use: deep/det.py:Detector}\n",
            "my.yaml": "include: sub/base.yaml\n",
        },
    )
    config = load(folder.path / "my.yaml")
    assert config.plugins == (str(tmp_path.resolve() / "sub/mine.py"),)
    assert config.perception.use == f"{tmp_path.resolve()}/sub/deep/det.py:Detector"
    with folder.inside():
        assert load(sets=("perception.use=det.py:D",)).perception.use == f"{tmp_path.resolve()}/det.py:D"


def test_goals_add_the_seek_phase() -> None:
    config = load_config(None, goals=["a cup", "a bed"], seed=9, environment={})
    assert config.mission.goals == ("a cup", "a bed")
    assert config.mission.phases == ("survey", "revisit", "seek")
    assert config.seed == 9
    again = load_config(None, goals=["a cup"], sets=["mission.phases=[seek]"], environment={})
    assert again.mission.phases == ("seek",)


def test_include_lists_merge_in_order_and_share_files(tmp_path: Path) -> None:
    written(tmp_path, "seed: 1\nname: a\n", "a.yaml")
    written(tmp_path, "include: a.yaml\nseed: 2\n", "b.yaml")
    config = load(written(tmp_path, "include: [a.yaml, b.yaml]\n"))
    assert (config.seed, config.name) == (2, "a")


def test_cyclic_include_is_refused(tmp_path: Path) -> None:
    written(tmp_path, "include: my.yaml\n", "b.yaml")
    error = refused(written(tmp_path, "include: b.yaml\n"))
    assert error.key == "include"
    assert "my.yaml -> b.yaml -> my.yaml" in str(error)
    assert "circle" in str(refused(written(tmp_path, "include: self.yaml\n", "self.yaml")))


@pytest.mark.parametrize(
    ("text", "key", "words"),
    [
        ("sead: 1", "sead", "did you mean 'seed'"),
        ("seed: abc", "seed", "expected a whole number, got 'abc'"),
        ("seed: -1", "seed", ">= 0, got -1"),
        ("seed: 1.5", "seed", "whole number"),
        ("name: a/b", "name", "'a/b'"),
        ("perception: oracle", "perception", "{use: oracle}"),
        ("perception: [1]", "perception", "expected a mapping"),
        ("perception: {use: 3}", "perception.use", "expected text, got 3"),
        ("mission: {phases: [survey, fly]}", "mission.phases[1]", "survey, revisit or seek, got 'fly'"),
        ("mission: {phases: [seek]}", "mission", "goals"),
        ("mission: {speed: 1}", "mission.speed", "did you mean 'linear_speed'"),
        ("mission: {max_frames: .inf}", "mission.max_frames", "finite number"),
        ("timeout_secs: .nan", "timeout_secs", "number"),
        ("on_error: ignore", "on_error", "skip or fail"),
        ("recording: {observers: [rerun]}", "recording.observers", "expected a mapping, got a list of 1"),
        ("recording: {observers: {rerun: 3}}", "recording.observers", "rerun: expected its options"),
        ("plugins: my.py", "plugins", "expected a list"),
        ("plugins: [3]", "plugins[0]", "expected text"),
        ("diagnosis: [{}]", "diagnosis[0].use", "missing"),
        ("include: 3", "include", "a path or a list of paths"),
    ],
)
def test_errors_name_file_key_and_what_would_do(tmp_path: Path, text: str, key: str, words: str) -> None:
    path = written(tmp_path, text)
    error = refused(path)
    assert (error.file, error.key) == (str(path), key)
    assert words in error.message
    assert "\n" not in str(error)


def test_errors_name_the_layer_that_is_to_blame(tmp_path: Path) -> None:
    path = written(tmp_path, "seed: 1\n")
    assert refused(path, {"DSSMSG__SEED": "x"}).file == "environment DSSMSG__SEED"
    assert refused(path, {"DSSMSG__SEED": "1"}, ("seed=x",)).file == "--set"
    base = written(tmp_path, "seed: x\n", "base.yaml")
    assert refused(written(tmp_path, "include: base.yaml\nname: a\n")).file == str(base)
    assert "key=value" in str(refused(sets=("seed",)))
    assert "DSSMSG__ASSOCIATION__USE" in str(refused(env={"DSSMSG__": "1"}))


def test_several_errors_are_counted_in_one_line(tmp_path: Path) -> None:
    error = refused(written(tmp_path, "seed: x\nname: 3\non_error: no\n"))
    assert "also wrong: " in error.message
    assert "\n" not in str(error)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("seed: 1\nseed: 2\n", "line 2: the key 'seed' is written twice"),
        ("mission: {goals: [a], goals: [b]}", "written twice"),
        ("1: 2", "a key must be text, got 1"),
        ("seed: !!python/object/apply:os.system [ls]", "tag"),
        ("seed: !!binary aGk=", "tag !!binary"),
        ("a: [1", "line 1: not valid YAML"),
        ("a: b: c", "line 1: not valid YAML"),
        ("- a\n- b\n", "expected `key: value` lines, got a list of 2"),
        ("just words", "got 'just words'"),
        ("seed: \x07", "not valid YAML"),
        ("seed: 1\n---\nseed: 2\n", "not valid YAML"),
        ("seed: *nobody", "undefined alias"),
    ],
)
def test_yaml_is_read_strictly(tmp_path: Path, text: str, words: str) -> None:
    path = written(tmp_path, text)
    error = refused(path)
    assert words in error.message
    assert error.file == str(path)


def test_alias_bomb_is_refused(tmp_path: Path) -> None:
    lines = ["a0: &a0 [x, x, x, x, x, x, x, x, x, x]"]
    lines += [f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 10)}]" for n in range(1, 12)]
    assert "aliases" in refused(written(tmp_path, "\n".join(lines))).message


def test_deep_and_recursive_documents_are_refused(tmp_path: Path) -> None:
    assert "levels deep" in refused(written(tmp_path, "a: " + "[" * 40 + "]" * 40)).message
    assert "levels deep" in refused(written(tmp_path, "a: " + "[" * 5000 + "]" * 5000)).message
    assert "holds itself" in refused(written(tmp_path, "a: &a [*a]")).message


def test_large_binary_and_odd_files_are_refused(tmp_path: Path) -> None:
    big = written(tmp_path, "#" * (MAX_BYTES + 1))
    assert "larger than 1,000,000 bytes" in refused(big).message
    big.write_bytes(b"\xff\xfe\x00seed")
    assert "UTF-8" in refused(big).message
    assert "folder" in refused(tmp_path).message
    assert "no such file" in refused(tmp_path / "nothing.yaml").message


def test_empty_file_is_the_default_and_bom_is_fine(tmp_path: Path) -> None:
    assert load(written(tmp_path, "")).resolved() == load().resolved()
    assert load(written(tmp_path, "\ufeffseed: 4\n")).seed == 4


def test_plain_scalars_are_what_a_user_takes_them_for() -> None:
    assert parse_yaml(
        "{a: 2026-01-31, b: 1e-3, c: 1.5E+3, d: 0x10, e: 12:30, f: 1_000, g: .5, h: on, i: 010}"
    ) == {
        "a": "2026-01-31",
        "b": 0.001,
        "c": 1500.0,
        "d": 16,
        "e": "12:30",
        "f": 1000,
        "g": 0.5,
        "h": "on",
        "i": "010",
    }


SECRETS = [
    *("api_key", "apikey", "hfapikey", "openai_key", "token", "access_token", "bearer", "auth", "basic_auth"),
    *("password", "passwd", "pwd", "db_pwd", "passphrase", "client-secret", "credential", "gcp_credentials"),
]


@pytest.mark.parametrize("key", SECRETS)
def test_secrets_are_refused_and_never_echoed(tmp_path: Path, key: str) -> None:
    path = written(tmp_path, f"llm: {{use: openai, {key}: hunter2}}\n")
    for error in (
        refused(path),
        refused(sets=(f"llm.{key}=hunter2",)),
        refused(env={f"DSSMSG__LLM__{key}": "hunter2"}),
    ):
        assert error.key == f"llm.{key}"
        assert "environment variable" in error.message
        assert "hunter2" not in str(error)


def test_words_that_only_look_like_secrets_pass() -> None:
    config = load(
        sets=(
            "llm.max_tokens=5",
            "llm.api_key_env=MY_KEY",
            "llm.keyword=a",
            "llm.key=name",
            "llm.monkey=a",
            "llm.author=a",
            "llm.url=http://127.0.0.1:8080/v1?version=2&max_tokens=5",
        )
    )
    assert config.llm.options["max_tokens"] == 5


@pytest.mark.parametrize(
    "url",
    [
        "https://me:hunter2@example.org/v1",
        "https://:hunter2@example.org/v1",
        "https://example.org/v1?api_key=hunter2",
        "https://example.org/v1?version=2&access_token=hunter2#top",
        "https://example.org/v1?key=hunter2",
    ],
)
def test_password_in_an_address_is_refused(url: str) -> None:
    error = refused(sets=(f"llm.url={url}",))
    assert "hunter2" not in str(error)
    assert error.key == "llm.url"


def test_dotted_key_follows_the_data_past_the_branches_of_a_union() -> None:
    data = {"a": {"b": [{"c": 1}]}}
    assert dotted_key(("a", "tagged-union[x]", "b", "list[model]", 0, "c", "int"), data) == "a.b[0].c"
    assert dotted_key(("a", "b", 0, "d"), data, keep_last=True) == "a.b[0].d"
    assert dotted_key(("a", "b", 7), data) == "a.b"


def test_origin_is_the_topmost_layer_that_says_most() -> None:
    layers = set_layers(["a.b=1", "a.c=[{d: 1}]", "a.b=2"])
    assert merge(layers) == {"a": {"b": 2, "c": [{"d": 1}]}}
    assert origin(layers, "a.c[0].d") == "--set"
    assert origin(layers, "z") is None


def test_random_bytes_end_in_a_config_error_or_a_configuration(tmp_path: Path) -> None:
    """Whatever a file holds, nothing but a ConfigError comes out."""
    generator, good = random.Random(5), packaged_file().read_bytes()
    path = tmp_path / "fuzz.yaml"
    for _ in range(150):
        data = bytearray(good[: generator.randrange(len(good))])
        for _ in range(generator.randrange(1, 12)):
            data[generator.randrange(len(data))] = (
                generator.choice(b"{}[]:&*!|>-'\"\\\n\t#%@`a1\x00\xff") if data else 0
            )
        path.write_bytes(bytes(data))
        with suppress(ConfigError):
            load(path)


def test_init_template_differs_from_the_default_in_name_and_plugins_only(tmp_path: Path) -> None:
    template = Path(dssmsg.__file__).parent / "data/templates/dssmsg.yaml"
    mine, default = load(template).resolved(), load().resolved()
    assert {key for key in mine if mine[key] != default[key]} == {"name", "plugins"}
    assert set(yaml.safe_load(template.read_text())) == set(yaml.safe_load(packaged_file().read_text()))


def test_a_goal_says_something() -> None:
    assert load_config(None, goals=["  the sofa "]).mission.goals == ("the sofa",)
    with pytest.raises(ConfigError, match="goals"):
        load_config(None, goals=["   "])
