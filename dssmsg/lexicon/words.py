"""Words of an English sentence: tokens, the singular of a plural, and a stem that its forms share."""

from __future__ import annotations

import functools
import re

MAX_CHARACTERS = 2000
MAX_TOKENS = 120
MAX_DIGITS = 3

_TOKEN = re.compile(r"[^\W_]+(?:['-][^\W_]+)*|[,;]")
_SHORT = {
    "'m": " am",
    "'re": " are",
    "'ve": " have",
    "'ll": " will",
    "'d": " would",
}
_SHORT_FORM = re.compile(r"(?<=\w)('m|'re|'ve|'ll|'d)\b")
_SHORT_IS = re.compile(r"\b(where|there|it|that|what|who|here|he|she|how)'s\b")
_IRREGULAR = {
    "knives": "knife",
    "shelves": "shelf",
    "bookshelves": "bookshelf",
    "loaves": "loaf",
    "scarves": "scarf",
    "children": "child",
    "people": "person",
    "men": "man",
    "women": "woman",
    "mice": "mouse",
    "teeth": "tooth",
    "feet": "foot",
    "couches": "couch",
    "glasses": "glass",
    "shoes": "shoe",
    "canoes": "canoe",
    "movies": "movie",
    "cookies": "cookie",
    "trousers": "trousers",
    "scissors": "scissors",
    "headphones": "headphones",
    "stairs": "stairs",
    "clothes": "clothes",
    "skis": "ski",
}


def tokens(text: str) -> tuple[str, ...]:
    """Lower-case words, commas and semicolons of a text; short forms such as `I'm` are written out.

    Only the first `MAX_CHARACTERS` characters and `MAX_TOKENS` tokens count.
    """
    plain = text[:MAX_CHARACTERS].lower().replace("\u2019", "'")
    plain = _SHORT_IS.sub(r"\1 is", plain)
    plain = _SHORT_FORM.sub(lambda found: _SHORT[found[1]], plain)
    return tuple(_TOKEN.findall(plain)[:MAX_TOKENS])


def is_number(word: str) -> bool:
    """Whether a word is a count in digits."""
    return word.isascii() and word.isdigit() and len(word) <= MAX_DIGITS


def singular(word: str) -> str:
    """The likely singular of an English noun."""
    known = _IRREGULAR.get(word)
    if known is not None:
        return known
    if word.endswith("ies") and len(word) > 4:
        return word[:-3] + "y"
    if word.endswith(("ches", "shes", "sses", "xes", "zes")):
        return word[:-2]
    return word[:-1] if word.endswith("s") and not word.endswith(("ss", "us", "is")) else word


_PAST_FORMS = {
    "kept": "keep", "sat": "sit", "ate": "eat", "eaten": "eat", "slept": "sleep", "made": "make",
    "done": "do", "found": "find", "left": "leave", "wrote": "write", "written": "write", "drank": "drink",
    "took": "take", "taken": "take", "spilt": "spill", "worn": "wear", "lying": "lie", "tying": "tie",
    "sang": "sing", "rode": "ride", "hung": "hang",
}  # fmt: skip


@functools.lru_cache(maxsize=20_000)
def stem(word: str) -> str:
    """What the forms of a word have in common: `washing`, `washed` and `wash` are one. Not a word itself."""
    plain = singular(word.removesuffix("'s"))
    plain = _PAST_FORMS.get(plain, plain)
    for ending in ("ing", "ed"):
        if plain.endswith(ending) and len(plain) - len(ending) >= 3:
            plain = plain[: -len(ending)]
            if len(plain) > 3 and plain[-1] == plain[-2] and plain[-1] not in "lsz":
                plain = plain[:-1]  # sitting, sit
            break
    if plain.endswith("y") and len(plain) > 2 and plain[-2] not in "aeiou":
        plain = plain[:-1] + "i"
    return plain[:-1] if plain.endswith("e") and len(plain) > 3 else plain
