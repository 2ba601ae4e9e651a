"""JSON documents: validated by pydantic, with a message for each fault, and written whole."""

import hashlib
import json
import re
from codecs import BOM_UTF8
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from difflib import get_close_matches
from functools import cache
from pathlib import Path
from typing import Any, TypeVar, get_args

from pydantic import BaseModel, ConfigDict, TypeAdapter, ValidationError
from pydantic_core import ErrorDetails, from_json

from pipeline.errors import InputError
from pipeline.files import read_bytes, write_text

Document = TypeVar("Document", bound=BaseModel)

DIALECT = "https://json-schema.org/draft/2020-12/schema"  # that pydantic writes
LONGEST = 400  # characters of a field's place, or of its value, that a message shows
MOST_FAULTS = 8  # faults of a file that are shown in full; the others are counted
MOST_BYTES = 2**28  # of a JSON file that is read; a plan of a thousand craft takes some MB
_LONG = re.compile(rb"(?<=[\s:,\[])-?\d{41,}(?=[\s,\]}])")  # an integer that no float is near to
CHECKSUM = "checksum"  # field with the checksum of all others, in documents that have one


class Strict(BaseModel):
    """Base class of documents and their parts, which refuses unknown keys."""

    model_config = ConfigDict(extra="forbid", frozen=True)


def parse_json(content: bytes) -> Any:
    """The value of a JSON text; ValueError if invalid, too large or deep, or with huge integers."""
    if len(content) > MOST_BYTES:
        raise ValueError(f"larger than {MOST_BYTES // 2**20} MiB")
    if found := _LONG.search(content):
        raise ValueError(f"it has an integer of more than 40 digits at byte {found.start()}")
    return from_json(content)


def validated(kind: Any, fields: Any) -> Any:
    """Validate values against a type or dataclass with pydantic; ValidationError if invalid."""
    return _validator(kind).validate_python(fields)


_validator = cache(TypeAdapter)  # made once for a type: that takes longer than most checks


def with_checksum(fields: Mapping[str, Any]) -> dict[str, Any]:
    """The fields of a document and the checksum of all of them."""
    return {**fields, CHECKSUM: _checksum(fields)}


def without_checksum(fields: Mapping[str, Any]) -> dict[str, Any]:
    """A document without its checksum, if any; ValueError where that is wrong."""
    rest = {name: value for name, value in fields.items() if name != CHECKSUM}
    if fields.get(CHECKSUM, _checksum(rest)) != _checksum(rest):
        raise ValueError("its checksum is not that of its content")
    return rest


def _checksum(fields: Mapping[str, Any]) -> str:
    """SHA-256 of fields as JSON, whatever their order and the white space between them."""
    plain = from_json(json.dumps(fields))  # keys are text, as they are once they are read
    return hashlib.sha256(json.dumps(plain, sort_keys=True).encode()).hexdigest()


def read_document(path: Path, kind: type[Document], what: str) -> Document:
    """The document of a kind in a file, or in standard input for -.

    InputErrors name the field that is missing or wrong, and ``what`` is expected.
    """
    try:
        content = read_bytes(path, MOST_BYTES + 1).removeprefix(BOM_UTF8)
    except OSError as error:
        raise InputError(f"{path} cannot be read ({error}); expected {what}.") from error
    return document_in(content, kind, path, what)


def document_in(content: bytes, kind: type[Document], where: object, what: str) -> Document:
    """Parse and validate a JSON text as a document; InputErrors name where the text is from."""
    try:
        return kind.model_validate(parse_unique_json(content))
    except ValidationError as error:  # which is a ValueError
        raise InputError(f"{where}: {faults(error, kind)}; expected {what}.") from error
    except InputError as error:  # of a value that refuses what it is made of
        raise InputError(f"{where}: {error}") from error
    except ValueError as error:
        raise InputError(f"{where} is not JSON: {error}; expected {what}.") from error


def parse_unique_json(content: bytes) -> Any:
    """As ``parse_json``; InputError for a field that is there twice, of which readers take one."""

    def once(fields: list[tuple[str, Any]]) -> None:
        names = [name for name, _ in fields]
        if len(set(names)) < len(names):
            ((name, _),) = Counter(names).most_common(1)
            raise InputError(
                f"{name[:LONGEST]} is there twice; expected each field once: remove one."
            )

    value = parse_json(content)
    # Numbers are of no interest here.
    json.loads(content, object_pairs_hook=once, parse_float=str, parse_int=str)
    return value


def document_from(fields: dict[str, Any], kind: type[Document]) -> Document:
    """A document from fields that are in no file; InputError names a wrong one."""
    try:
        return kind.model_validate(fields)
    except ValidationError as error:
        raise InputError(f"{faults(error, kind)}.") from error


def faults(error: ValidationError, kind: type[BaseModel]) -> str:
    """Field and fault of every error of a kind of document, in one line."""
    found = error.errors(include_url=False)
    if any(fault["loc"] == ("schema",) for fault in found):  # the others follow from it
        found = [fault for fault in found if fault["loc"] == ("schema",)]
    text = "; ".join(_fault(fault, kind) for fault in found[:MOST_FAULTS])
    return text + (f"; and {len(found) - MOST_FAULTS} more" if len(found) > MOST_FAULTS else "")


def first_fault(error: ValidationError) -> str:
    """Field and fault of the first error, such as ``initial[2][5] is nan: ...``."""
    return _fault(error.errors(include_url=False)[0])


def _fault(fault: ErrorDetails, kind: type[BaseModel] | None = None) -> str:
    unknown = fault["type"] in ("extra_forbidden", "unexpected_keyword_argument")
    end = len(fault["loc"]) - unknown  # after which is the unknown field, whatever it is called
    # What stands in parentheses, or is a type, names a field's form, which is no place in the file.
    forms = ("(", "literal[", "tuple[")
    places = [k for k in fault["loc"][:end] if not str(k).startswith(forms)]
    places += fault["loc"][end:]
    where = "".join(f"[{k}]" if isinstance(k, int) else f".{k}" for k in places).lstrip(".")
    where = where[:LONGEST]
    what = fault["msg"].removeprefix("Value error, ")
    what = what[0].lower() + what[1:]
    if fault["type"] == "model_type":
        what = 'input should be an object, {"field": value, ...}'
    if not where:
        return what
    if fault["type"] in ("missing", "missing_argument"):
        return f"{where} is missing"
    if unknown:
        near = () if kind is None else get_close_matches(str(places[-1]), _fields(kind, places))
        cure = f" (did you mean {near[0]}?)" if near else "; remove it"
        return f"{where} is not a field of this schema{cure}"
    given = fault["input"]
    shown = f" is {given!r}"[:LONGEST] if isinstance(given, str | int | float | bool | None) else ""
    return f"{where}{shown}: {what}"


def _fields(kind: type[BaseModel], places: Sequence[str | int]) -> list[str]:
    """Names of all fields of the object that holds the last part of a path into a document."""
    models = [kind]
    for name in (place for place in places[:-1] if isinstance(place, str)):
        fields = [one.model_fields[name] for one in models if name in one.model_fields]
        models = [model for field in fields for model in _models(field.annotation)]
    return [field.alias or name for one in models for name, field in one.model_fields.items()]


def _models(annotation: Any) -> Iterator[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for part in get_args(annotation):
        yield from _models(part)


def write_document(path: Path, fields: dict[str, Any]) -> None:
    """Write a JSON file that appears whole, a line for each row of numbers or listed object."""
    write_text(path, _json(fields, "\n ") + "\n")


def _json(value: Any, line: str) -> str:
    deeper = line + " "
    if isinstance(value, dict) and value:
        parts = [f"{json.dumps(key)}: {_json(one, deeper)}" for key, one in value.items()]
        return "{" + line + ("," + line).join(parts) + line[:-1] + "}"
    if isinstance(value, list) and value and isinstance(value[0], list):
        return "[" + line + ("," + line).join(_json(one, deeper) for one in value) + line[:-1] + "]"
    if isinstance(value, list) and value and isinstance(value[0], dict):
        parts = [json.dumps(one, allow_nan=False) for one in value]
        return "[" + line + ("," + line).join(parts) + line[:-1] + "]"
    return json.dumps(value, allow_nan=False)
