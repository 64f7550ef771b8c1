"""DRIP against the examples of the standards, byte for byte.

RFC 9575, appendix B.2.1, as draft-ietf-drip-auth-49 prints it; RFC 9374, section 5; RFC 9886, appendix A;
RFC 8032, section 7.1; NIST SP 800-185, sample 1 of cSHAKE.
"""

from __future__ import annotations

from ipaddress import IPv6Address

import pytest
from Crypto.Hash import cSHAKE128

from skyrange.codec.drip import (
    EntityTag,
    Evidence,
    Link,
    SamType,
    decode_manifest,
    decode_sam,
    decode_wrapped,
    encode_manifest,
    encode_sam,
    join_with_parity,
    link_hash,
    message_hash,
    page_count,
    parse_session_id,
    session_id,
    split_with_parity,
)
from skyrange.codec.f3411 import Authentication, BasicId, decode, encode
from skyrange.remoteid.drip.registry import Identity, public_key, sign, verify

KEY = bytes.fromhex("b5fef530d450dedb59ebafa18b00d7f5ed0ac08a81975034297bea2b00041813")
TAG = IPv6Address("2001:3f:fe00:105:a29b:3ff4:2226:c04e").packed
MESSAGES = """
0240012001003ffe000105a29b3ff42226c04e000000000000
12000000000000000000000000000000000000000060220000
32004578616d706c652053656c662049440000000000000000
420000000000000000000100000000000000000010ea510900
52004578616d706c65204f70657261746f7220494400000000
0240012001003ffe000105a29b3ff42226c04e000000000000
12000000000000000000000000000000000000000060220000
420000000000000000000100000000000000000010ea510900
"""
LINK = """
2250078910ea510904314b8564b17e66662001003ffe000105
2251a29b3ff42226c04eb5fef530d450dedb59ebafa18b00d7
2252f5ed0ac08a81975034297bea2b000418132001003ffe00
22530105b82bf1c99d87273103fc83f6ecd9b91842f205c222
2254dd71d8e165ad18ca91daf9299a73eec850c756a7e9be46
2255f51dddfa0f09db7bfdde14eec07c7a6dd1061c1d5ace94
2256d9ad97940d280000000000000000000000000000000000
2257a03b0f7a6feb0d198167045058cfc49f73129917024d22
"""
WRAPPER = """
2250078b10ea510902e0dd7c6560115e671200000000000000
22510000000000000000000000000060220000420000000000
2252000000000100000000000000000010ea5109002001003f
2253fe000105a29b3ff42226c04ef0ecad581a030ca790152a
22542f08df5762a463e24a742d1c530ec977bbe0d113697e2b
2255b909d6c7557bdaf1227ce86154b030daadda4a6b8474de
22569a62f6c375020826000000000000000000000000000000
2257f5e8eebcb04f8c2197526053e66c010d5d7297ff7c1fe0
"""
MANIFEST = """
225008b110ea510903e0dd7c6560115e670000000000000000
2251d57594875f8608b4d61dc9224ecf8b842bd4862734ed01
22522ca2e5f2b8a3e61547b81704766ba3eeb651be7eafc928
22538884e3e28a24fd5529bc2bd4862734ed012ca2e5f2b8a3
2254e61547b81704766ba3eeb62001003ffe000105a29b3ff4
22552226c04efb729846e7d110903797066fd96f49a77c5a48
2256c4c3b330be05bc4a958e9641718aaa31aeabad368386a2
22579ed2dce2769120da83edbcdc0858dd1e357755e7860317
2258e7c06a5918ea62a937391cbfe0983539de1b2e688b7c83
"""


def lines(text: str) -> list[bytes]:
    return [bytes.fromhex(line) for line in text.split()]


def pages_of(text: str) -> dict[int, Authentication]:
    pages = [decode(body) for body in lines(text)]
    return {page.page: page for page in pages if isinstance(page, Authentication)}


@pytest.mark.parametrize("text", [LINK, WRAPPER, MANIFEST], ids=["link", "wrapper", "manifest"])
def test_rfc_9575_pages_and_parity(text: str) -> None:
    pages = pages_of(text)
    data, replaced = join_with_parity(pages)
    assert replaced is None
    assert encode_sam(decode_sam(data)) == data
    again = split_with_parity(data, pages[0].timestamp_s or 0, parity=True)
    assert [encode(page) for page in again] == lines(text)
    for lost in pages:
        rest = {number: page for number, page in pages.items() if number != lost}
        assert join_with_parity(rest) == (data, None if lost == max(pages) else lost)


def test_rfc_9575_tag() -> None:
    tag = EntityTag.parse(TAG)
    assert (tag.raa, tag.hda, tag.suite) == (16376, 1, 5)
    assert tag.commits_to(KEY)
    assert EntityTag.of_key(16376, 1, KEY).bytes_ == TAG
    said = decode(lines(MESSAGES)[0])
    assert isinstance(said, BasicId)
    assert parse_session_id(said.uas_id) == TAG
    assert said.uas_id == session_id(TAG)


def test_rfc_9575_wrapper() -> None:
    wrapper = decode_sam(join_with_parity(pages_of(WRAPPER))[0])
    assert isinstance(wrapper, Evidence)
    assert wrapper.sam_type == SamType.WRAPPER
    assert wrapper.tag == TAG
    assert decode_wrapped(wrapper.evidence) == tuple(lines(MESSAGES)[row] for row in (1, 3))
    assert verify(KEY, wrapper.signature, wrapper.signed())
    assert not verify(KEY, wrapper.signature, wrapper._replace(vna_s=wrapper.vna_s + 1).signed())


def test_rfc_9575_manifest() -> None:
    printed = join_with_parity(pages_of(LINK))[0]
    assert printed[0] == SamType.FRAME  # an error of the example: 4 instead of 1
    link = decode_sam(bytes([SamType.LINK]) + printed[1:])
    evidence = decode_sam(join_with_parity(pages_of(MANIFEST))[0])
    assert isinstance(link, Link)
    assert isinstance(evidence, Evidence)
    assert (link.child, link.child_key) == (TAG, KEY)
    assert verify(KEY, evidence.signature, evidence.signed())
    manifest = decode_manifest(evidence.evidence)
    assert manifest.link == link_hash(link)
    assert sorted(manifest.messages) == sorted(message_hash(body) for body in lines(MESSAGES))
    assert manifest.current == manifest.own_hash
    assert encode_manifest(manifest.previous, manifest.link, manifest.messages) == manifest


def test_rfc_9575_page_counts() -> None:
    """Appendix B.1, table 5: pages of Wrappers and Manifests, without and with parity."""
    wrappers = [(5, 6), (6, 7), (7, 8), (8, 9), (9, 10)]
    manifests = [(6, 7), (6, 7), (6, 7), (7, 8), (7, 8), (7, 8), (8, 9), (8, 9), (8, 9), (9, 10), (9, 10), (9, 11)]
    for wrapped, (plain, protected) in enumerate(wrappers):
        size = 89 + 25 * wrapped
        assert (page_count(size, parity=False), page_count(size, parity=True)) == (plain, protected)
    for hashes, (plain, protected) in enumerate(manifests):
        size = 89 + 8 * (hashes + 3)
        assert (page_count(size, parity=False), page_count(size, parity=True)) == (plain, protected)


def test_rfc_9374_hierarchy() -> None:
    """Section 5: RAA 10, HDA 20."""
    tag = EntityTag.parse(IPv6Address("2001:30:280:1405:a3ad:1952:ad0:a69e").packed)
    assert (tag.raa, tag.hda, tag.suite) == (10, 20, 5)
    assert tag.address == "2001:30:280:1405:a3ad:1952:ad0:a69e"
    assert not tag.is_authority
    assert EntityTag(16376, 0, 5, bytes(8)).is_authority


# RFC 9886, figure 21: the endorsements of an aircraft, from the RAA (which endorses itself) down.
CHAIN = """
01FADEF6670AEDF6672001003FFE0000055E60A1571E91A0B79990D5B04B72A18066D4092B52C7D4994FB7C16BD7E8C1F440FFA8D04FF1E13F
2001003FFE0000055E60A1571E91A0B7BC2F66D4982EBD7B7B5B6A38C313EE99A4F520FDD340DDDF40FDBC86922748896C4B0ABC5023639B66
9DEE9753BE6D84A9F38940D3CA0A5BD1666E2A4CEE450C
0197E0F667A7EEF6672001003FFE000A056615EE45D42709A0CE681E36E1141AEB560D6E76BC796B7B7CB454E463CCB1F12DE30A380101803F
2001003FFE0000055E60A1571E91A0B7EFDEAFA62D1077C9AE539A363CFB70B37680D94FD459F97A4DE610E203A272CB1049BD47B0C4BCCF36
14D7429F2F103EF55C013CDAD326B777C1E336F358D40B
010AE1F6671AEFF6672001003FFE000A05260ED4376B256E288233FDAEB5068BC14859D113A0EDFCF8DC07814E3DD2765E6B5B82E04D070597
2001003FFE000A056615EE45D42709A088F20AB8890B10320164CE1CF9A51CBD3630A4A9B07BE2893CDEAB0047F4AFD1AF3E350988B1F476B3
00838064EF0571F53933E58B2C96686905811E731B4D0C
01DCE2F667ECF0F6672001003FFE000A05130824699A4BC6B2C92E2F9D97E8960F9B5F1654F8B09039F9DADC5BCF061EAC4F0CEA79E8E877FA
2001003FFE000A05260ED4376B256E2880E7DCF234E29982E64CE3B2159A14C768CE3B0B41D639EA509AFA6D86B03283EB4773252860465AC5
73D725CDA94511A02A98770B187BAD6F7798BA609AA701
"""


def test_rfc_9886_chain_of_links() -> None:
    """Real endorsements verify, and each tag commits to its key. Their times count from 1970, as those of RFC 9575's
    example do, against its text.
    """
    stream = bytes.fromhex("".join(CHAIN.split()))
    keys: dict[bytes, bytes] = {}
    for at in range(0, len(stream), 137):
        link = decode_sam(stream[at : at + 137])
        assert isinstance(link, Link)
        assert EntityTag.parse(link.child).commits_to(link.child_key)
        keys[link.child] = link.child_key
        assert verify(keys[link.parent], link.signature, link.signed)
        assert encode_sam(link) == stream[at : at + 137]
    assert len(keys) == 4
    assert keys.popitem()[0] == IPv6Address("2001:3f:fe00:a05:1308:2469:9a4b:c6b2").packed


RFC_8032 = [
    (
        "9d61b19deffd5a60ba844af492ec2cc44449c5697b326919703bac031cae7f60",
        "d75a980182b10ab7d54bfed3c964073a0ee172f3daa62325af021a68f707511a",
        "",
        "e5564300c360ac729086e2cc806e828a84877f1eb8e5d974d873e065224901555fb8821590a33bacc61e39701cf9b46bd25bf5f0595bbe246"
        "55141438e7a100b",
    ),
    (
        "4ccd089b28ff96da9db6c346ec114e0f5b8a319f35aba624da8cf6ed4fb8a6fb",
        "3d4017c3e843895a92b70aa74d1b7ebc9c982ccf2ec4968cc0cd55f12af4660c",
        "72",
        "92a009a9f0d4cab8720e820b5f642540a2b27b5416503f8fb3762223ebdb69da085ac1e43e15996e458f3613d0f11d8c387b2eaeb4302aeeb"
        "00d291612bb0c00",
    ),
]


@pytest.mark.parametrize(("secret", "key", "message", "signature"), RFC_8032)
def test_rfc_8032_signatures(secret: str, key: str, message: str, signature: str) -> None:
    assert public_key(bytes.fromhex(secret)).hex() == key
    assert sign(bytes.fromhex(secret), bytes.fromhex(message)).hex() == signature
    assert verify(bytes.fromhex(key), bytes.fromhex(signature), bytes.fromhex(message))
    assert not verify(bytes.fromhex(key), bytes.fromhex(signature), bytes.fromhex(message) + b"\0")


def test_identity_commits_to_its_key() -> None:
    who = Identity.of_secret(bytes(range(32)), 15360, 1)
    assert EntityTag.parse(who.tag).commits_to(who.key)


def test_nist_cshake_sample() -> None:
    found = cSHAKE128.new(data=bytes(range(4)), custom=b"Email Signature").read(32)
    assert found.hex() == "c1c36925b6409a04f1b504fcbca9d82b4017277cb5ed2b2065fc1d3814d5aaf5"
