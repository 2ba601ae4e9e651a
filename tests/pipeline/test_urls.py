"""What a URL may show, and what a sentence with URLs in it may."""

from urllib.parse import quote

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.text import public, public_url

PLAIN = [
    "data/paper",
    "/data/me@home/n10",
    "models:/prolearn-ff1@champion",
    "sqlite:///mlflow.db",
    "sqlite:////home/me@work/mlflow.db",
    "tcp://10.0.0.1:8786",
    "tcp://[::1]:8786",
    "s3://bucket/some@where/n10",
    "no address at all: what now?",
    "no workers at tcp://10.0.0.1:8786; start some (see https://dask.org/).",
]

SHOWN = {
    "s3://key:secret@bucket/n10": "s3://bucket/n10",
    "s3://bucket/n10?region=x&sig=secret": "s3://bucket/n10",
    "https://secret@host/n10#secret": "https://host/n10",
    "http://me:se@cret@host:5000": "http://host:5000",
    "postgresql+psycopg2://me:secret@host/runs?password=secret": "postgresql+psycopg2://host/runs",
    "simplecache::http://me:secret@host/n10": "simplecache::http://host/n10",
    "https://host/?of=http://other/x&token=secret": "https://host/",
    "https://host/n10#s3://secret": "https://host/n10",
}


@pytest.mark.parametrize("text", PLAIN)
def test_what_holds_no_secret_stays_as_it_is(text):
    assert public(text) == text
    assert public_url(text) == text


@pytest.mark.parametrize("url", SHOWN)
def test_user_password_query_and_fragment_are_left_out_of_a_url_and_of_a_sentence(url):
    assert public(url) == public_url(url) == SHOWN[url]
    assert public(f"cannot open ('{url}'), sorry.") == f"cannot open ('{SHOWN[url]}'), sorry."


PASSWORDS = st.text(st.characters(exclude_categories=["C", "Z"]), min_size=8)
MARKS = st.lists(st.sampled_from(["://", "/", "@", "?", "#", ":", "s3", "'", ")"]), min_size=1)


@given(
    st.tuples(PASSWORDS, PASSWORDS) | st.tuples(MARKS.map("".join), MARKS.map("".join)),
    st.sampled_from(["s3", "memory", "http", "postgresql"]),
    st.booleans(),
)
def test_no_password_whatever_is_in_it_is_shown(around, scheme, escaped):
    password = f"<{around[0]}SECRET{around[1]}>"
    given = quote(password, safe="") if escaped else password
    url = f"{scheme}://me:{given}@host:80/n10"
    for shown in (public(url), public_url(url), public(f"{url} is gone", url)):
        assert "SECRET" not in shown
        assert "me:" not in shown
    if not set(given) & set("/?#"):
        assert public_url(url) == f"{scheme}://host:80/n10"


@given(PASSWORDS | MARKS.map("".join))
def test_no_password_is_shown_however_a_library_quotes_it(password):
    password = f"<{password}>"
    for typed in (password, quote(password, safe="")):
        for said in (password, quote(password, safe=""), repr(password)[1:-1]):
            assert said not in public(f"no login by {said}", f"ftp://me:{typed}@host/n10")


def test_where_a_password_cannot_be_told_from_the_rest_only_the_scheme_is_shown():
    for password in ("se/cret", "se?cret", "s@e#cret", "s@e/cret"):
        assert public_url(f"ftp://me:{password}@host:21/n10") == "ftp://..."


def test_text_without_urls_takes_time_in_proportion_to_its_length():
    assert public(10**6 * "a") == 10**6 * "a"  # half an hour in squares of it


def test_two_urls_side_by_side_are_both_shown_where_no_password_is_in_them():
    assert public("s3://a/b?sig=secret,tcp://10.0.0.1:8786") == "s3://a/b,tcp://10.0.0.1:8786"
    assert public("s3://a/b,http://me:secret@host/c") == "s3://..."


def test_a_url_with_spaces_is_known_where_it_is_named():
    url = "memory://me:my secret@host/my data?token=t o k"
    assert public_url(url) == "memory://host/my data"
    assert public(f"{url} is gone", url) == "memory://host/my data is gone"


@pytest.mark.parametrize(
    "said",
    [
        "[Errno 2] /me:s%40cret@host/n10?token=abc/_manifest.json",
        "no such file: /me:s@cret@host/n10",
        "invalid literal for int(): 's@cret'",
        "Port could not be cast to integer value as 's%40cret'",
        "Max retries exceeded with url: /n10?token=abc",
        "token abc has expired",
    ],
)
def test_what_a_library_says_loses_the_secrets_of_the_url_in_any_form(said):
    told = public(said, "memory://me:s%40cret@host/n10?token=abc")
    for secret in ("s%40cret", "s@cret", "abc", "cret"):
        assert secret not in told


def test_an_address_without_its_scheme_keeps_its_password_to_itself():
    assert public_url("me:secret@10.0.0.1:8786") == "10.0.0.1:8786"
