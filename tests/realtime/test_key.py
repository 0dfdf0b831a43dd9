"""Who may speak: addresses and keys."""

from __future__ import annotations

import pytest

from moc_opt.realtime.key import LOOPBACK_KEY, VARIABLE, WireError, checked_key, parse_address, read_key


def test_addresses():
    assert parse_address("127.0.0.1:30200", "--listen") == ("127.0.0.1", 30200)
    assert parse_address("localhost:0", "--listen") == ("127.0.0.1", 0)
    for wrong in ("30200", "127.0.0.1", ":30200", "127.0.0.1:x", "127.0.0.1:70000", "no such host.invalid:1"):
        with pytest.raises(WireError, match="--listen"):
            parse_address(wrong, "--listen")


def test_a_key_comes_from_the_file_or_else_from_the_environment(tmp_path, monkeypatch):
    monkeypatch.delenv(VARIABLE, raising=False)
    assert read_key(None) is None
    monkeypatch.setenv(VARIABLE, "of the environment")
    file = tmp_path / "key"
    file.write_text("of the file, longer\n")
    assert read_key(None) == b"of the environment"
    assert read_key(file) == b"of the file, longer"
    for wrong in ("short", "x" * 33, ""):
        file.write_text(wrong)
        with pytest.raises(WireError, match="16 to 32"):
            read_key(file)
    file.write_bytes(b"\xff" * 20)
    with pytest.raises(WireError, match="cannot be read"):
        read_key(file)


def test_other_machines_need_a_key():
    assert checked_key(None, "127.0.0.1", "--listen") == LOOPBACK_KEY
    assert checked_key(b"k" * 16, "192.0.2.1", "--listen") == b"k" * 16
    for host in ("192.0.2.1", "0.0.0.0"):
        with pytest.raises(WireError, match="key-file"):
            checked_key(None, host, "--listen")
