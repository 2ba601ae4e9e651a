"""JSON documents of any content are read or refused in a sentence."""

import json
from pathlib import Path

import pytest
from pydantic import BaseModel

from pipeline.documents import (
    Strict,
    document_in,
    parse_json,
    parse_unique_json,
    read_document,
    with_checksum,
    without_checksum,
)
from pipeline.errors import InputError


class Numbers(BaseModel):
    values: list[float]


class StrictNumbers(Strict):
    values: list[float]


HOSTILE = {
    "200,000 brackets": b"[" * 200_000,
    "an integer of 5,000 digits": b'{"values": [' + b"9" * 5000 + b"]}",
    "an integer of 400 digits": b'{"values": [1, ' + b"9" * 400 + b"]}",
    "bytes that are no text": b"\xff\xfe\x00",
    "nothing": b"",
    "half a pair of surrogates": b'{"values": "\\ud800"}',
}


@pytest.mark.parametrize("content", HOSTILE.values(), ids=HOSTILE.keys())
def test_what_is_no_sound_json_is_refused_in_a_sentence(tmp_path, content):
    path = tmp_path / "given.json"
    path.write_bytes(content)
    with pytest.raises(InputError, match=r"given.json is not JSON: .+; expected numbers"):
        read_document(path, Numbers, "numbers")
    with pytest.raises(ValueError, match=r"line 1|more than 40 digits"):
        parse_json(content)


def test_a_file_without_end_is_refused():
    with pytest.raises(InputError, match="larger than 256 MiB"):
        read_document(Path("/dev/zero"), Numbers, "numbers")


FIELDS = {"b": [1, 2.5, None], "a": {"2": "two", "10": "ten"}}


def test_a_checksum_holds_whatever_the_order_of_fields_and_the_spaces_between():
    written = json.dumps(with_checksum(FIELDS), indent=3, sort_keys=True)
    assert without_checksum(json.loads(written)) == FIELDS


def test_fields_without_a_checksum_are_of_an_earlier_version():
    assert without_checksum(FIELDS) == FIELDS


def test_a_flipped_bit_anywhere_in_a_document_is_found():
    written = json.dumps(with_checksum(FIELDS)).encode()
    for k in range(8 * len(written)):
        content = bytearray(written)
        content[k // 8] ^= 1 << k % 8
        try:
            found = without_checksum(parse_json(bytes(content)))
        except ValueError:
            continue
        assert found != FIELDS  # the field "checksum" has another name: an unknown field remains
        assert len(found) > len(FIELDS)


LONG = 10**6 * "x"


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ({"values": [LONG]}, r"values\[0\] is 'xxx"),
        ({"values": [], LONG: 1}, "xxx is not a field of this schema"),
        ({"values": [], "(values)": 1}, r"\(values\) is not a field of this schema"),
    ],
)
def test_a_fault_is_named_in_a_short_sentence_whatever_is_in_the_file(content, said):
    with pytest.raises(InputError, match=said) as refused:
        document_in(json.dumps(content).encode(), StrictNumbers, "given.json", "numbers")
    assert len(str(refused.value)) < 600


def test_a_field_that_is_there_twice_is_named_in_a_short_sentence():
    others = "".join(f'"{k}": 1, ' for k in range(20_000))
    with pytest.raises(InputError, match="xxx is there twice") as refused:
        parse_unique_json(f'{{{others}"{LONG}": 1, "{LONG}": 2}}'.encode())
    assert len(str(refused.value)) < 600
