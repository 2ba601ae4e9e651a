"""JSON documents of any content are read or refused in a sentence."""

import json
from pathlib import Path

import pytest
from pydantic import BaseModel

from pipeline.documents import parse_json, read_document, with_checksum, without_checksum
from pipeline.errors import InputError


class Numbers(BaseModel):
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
