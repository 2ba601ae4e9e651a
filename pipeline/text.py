"""Safe display of foreign text: invisible characters as escapes, URLs without secrets."""

import re
import shlex
from collections.abc import Callable
from pathlib import Path
from urllib.parse import quote, unquote

# Unicode's Default_Ignorable_Code_Point as far as ``str.isprintable`` lets it pass, and the blank
# of braille
_BLANK = re.compile(
    "[\u034f\u115f\u1160\u17b4\u17b5\u180b-\u180d\u180f\u2800\u3164\ufe00-\ufe0f\uffa0"
    "\U000e0100-\U000e01ef]"
)


def _escape(character: str) -> str:
    r"""As in Python's strings: ``\x1b``, ``\u202e``, ``\n``."""
    return character.encode("unicode_escape").decode()


def visible(text: str, escape: Callable[[str], str] = _escape) -> str:
    """A text on one line, with control, invisible and bidirectional characters as escapes."""
    hidden = {ord(c): escape(c) for c in set(text) if not c.isprintable() or _BLANK.match(c)}
    return text.translate(hidden) if hidden else text


def first_line(error: object) -> str:
    """The first line of an error's text, or its class where there is none."""
    return next(iter(str(error).strip().splitlines()), type(error).__name__)


def as_argument(place: object) -> str:
    """A path or URL as one word of a command line that is not taken for an option."""
    text = str(place)
    return shlex.quote(f"./{text}" if text.startswith("-") else text)


HIDDEN = "..."
_URLS = re.compile(r"(?<![\w.+-])[\w.+-]+://\S*")  # in a sentence, with what is directly behind
# Up to a second one directly behind, which a value of a query or a fragment is not
_URL = re.compile(r"[\w.+-]+://(?:(?!(?<![=?&#\w.+-])[\w.+-]+://)\S)*")
_CLOSING = ".,;:!?'\"`)]}>"  # ends a sentence, bracket or quotation
_BARE = re.compile(r"[^/\\@\s][^/\\@\s:]*:[^/\\@\s]*@")  # user and password without the scheme


def public(text: object, *urls: object) -> str:
    """A sentence, or a URL without spaces, without the secrets of the URLs in it.

    Secrets of ``urls`` are removed in any form: with spaces, without the scheme, or quoted alone.
    """
    shown = str(text)
    for url in map(str, urls):
        _, before, _, after = _parts(url)
        for piece in {before, after, unquote(before), unquote(after)}:
            shown = shown.replace(piece, "") if len(piece) > 1 else shown
        for word in sorted(_words(before, after), key=len, reverse=True):
            shown = re.sub(rf"(?<!\w){re.escape(word)}(?!\w)", HIDDEN, shown)
    return _URLS.sub(_in_sentence, shown)


def public_url(url: object) -> str:
    """A URL without its secrets, or its scheme alone where they are unclear; a path as it is."""
    scheme, _, shown, _ = _parts(str(url))
    return scheme + shown


def sqlite_url(path: Path) -> str:
    """The address of an SQLite file, where SQLAlchemy decodes ``%`` and a ``?`` ends the name."""
    # There slashes are encoded too: MLflow makes the folder that an address names as it stands.
    name = str(path)
    return f"sqlite:///{quote(name, safe='') if {'%', '?'} & {*name} else name}"


def _parts(url: str) -> tuple[str, str, str, str]:
    """Scheme, secrets before the host, what may be shown, and secrets after the path."""
    scheme, mark, rest = url.partition("://")
    if not mark:
        bare = _BARE.match(url)
        return ("", bare[0], url[bare.end() :], "") if bare else ("", "", url, "")
    authority = re.split(r"[/?#]", rest, maxsplit=1)[0]
    tail = rest[len(authority) :]
    if "@" in tail and (":" in authority or "@" in authority or "://" in tail):
        return scheme + mark, rest, HIDDEN, ""
    begin = authority.rfind("@") + 1
    end = len(re.split(r"[?#]", rest, maxsplit=1)[0])
    return scheme + mark, rest[:begin], rest[begin:end], rest[end:]


def _words(before: str, after: str) -> set[str]:
    """Passwords and values of a query, as a library may quote them alone, whole or in part."""
    password = (before.partition(":")[2] or before).rstrip("@")
    values = [pair.partition("=")[2] or pair for pair in re.split(r"[?#&;]", after)]
    # Where the host is unclear, the last part of what may be the password is the host.
    known = password, password.rpartition("@")[0]
    words = [*known, *re.split(r"[/:@?#]", password), *values]
    plain = {form for word in words for form in (word, unquote(word)) if form}
    return plain | {form for one in plain for form in (quote(one, safe=""), repr(one)[1:-1])}


def _in_sentence(found: re.Match[str]) -> str:
    # What looks like a second URL may be part of a password.
    unclear = "@" in found[0] and len(_URL.findall(found[0])) > 1
    return public_url(found[0]) if unclear else _URL.sub(_without_closing, found[0])


def _without_closing(found: re.Match[str]) -> str:
    url = found[0].rstrip(_CLOSING)
    return public_url(url) + found[0][len(url) :]
