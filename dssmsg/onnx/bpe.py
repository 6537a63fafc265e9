"""CLIP's tokenizer from the vocabulary file of OpenAI's code, for models without a `tokenizer.json`."""

from __future__ import annotations

import gzip
import zlib
from pathlib import Path
from typing import Any

from dssmsg.errors import InputError

START, END = "<|startoftext|>", "<|endoftext|>"
SPECIAL = r"<\|startoftext\|>|<\|endoftext\|>"
WORDS = SPECIAL + r"|'s|'t|'re|'ve|'m|'ll|'d|[\p{L}]+|[\p{N}]|[^\s\p{L}\p{N}]+"
MERGES = 49152 - 256 - 2
"""How many of the file's merges the models were trained with; the rest of the file is never used."""
MOST_BYTES = 16_000_000


def vocabulary_tokenizer(file: Path) -> Any:
    """A `tokenizers.Tokenizer` from `bpe_simple_vocab_16e6.txt.gz` (or unpacked): a header, then merges.

    Raises InputError if the file is something else.
    """
    from tokenizers import Regex, Tokenizer, models, normalizers, pre_tokenizers

    merges = _merges(file)
    letters = _letters()
    tokens = letters + [letter + "</w>" for letter in letters]
    tokens += [first + second for first, second in merges]
    tokens += [START, END]
    numbers = {token: number for number, token in enumerate(tokens)}
    missing = [part for pair in merges for part in pair if part not in numbers]
    if missing or len(numbers) != len(tokens):
        raise InputError("its merges do not build on one another", file=file, key=".tokenizer")
    made = Tokenizer(models.BPE(numbers, merges, end_of_word_suffix="</w>", unk_token=END))
    made.normalizer = normalizers.Sequence(
        [normalizers.NFC(), normalizers.Replace(Regex(r"\s+"), " "), normalizers.Lowercase()]
    )
    made.pre_tokenizer = pre_tokenizers.Sequence(
        [
            pre_tokenizers.Split(Regex(WORDS), behavior="removed", invert=True),
            pre_tokenizers.ByteLevel(add_prefix_space=False, use_regex=False),
        ]
    )
    return made


def _merges(file: Path) -> list[tuple[str, str]]:
    try:
        with gzip.open(file) if file.suffix == ".gz" else file.open("rb") as stream:
            content = stream.read(MOST_BYTES + 1)
        text = content.decode("utf-8")
    except (OSError, EOFError, zlib.error, UnicodeDecodeError) as error:
        raise InputError(f"cannot be read as a vocabulary: {error}", file=file, key=".tokenizer") from error
    if len(content) > MOST_BYTES:
        raise InputError(f"expected at most {MOST_BYTES} bytes", file=file, key=".tokenizer")
    pairs = [tuple(line.split()) for line in text.splitlines()[1 : MERGES + 1]]
    if not pairs or any(len(pair) != 2 for pair in pairs):
        raise InputError(
            "expected a header and then two pieces of words a line, as in bpe_simple_vocab_16e6.txt.gz",
            file=file,
            key=".tokenizer",
        )
    return [(pair[0], pair[1]) for pair in pairs]


def _letters() -> list[str]:
    """A visible character for each byte, in the order in which CLIP numbers them: printable ones first."""
    printable = [*range(33, 127), *range(161, 173), *range(174, 256)]
    others = [byte for byte in range(256) if byte not in printable]
    return [*map(chr, printable), *(chr(256 + place) for place in range(len(others)))]
