"""DRIP in bytes: entity tags (RFC 9374), and the messages and pages by which they authenticate Remote ID (RFC 9575).

Nothing here signs or verifies: `remoteid.drip` does.
"""

from skyrange.codec.drip.entity_tags import (
    APEX_HID,
    EDDSA_CSHAKE128,
    KEY_BYTES,
    TAG_BYTES,
    EntityTag,
    parse_session_id,
    session_id,
)
from skyrange.codec.drip.hashes import HASH_BYTES, message_hash, pages_hash
from skyrange.codec.drip.messages import (
    EXPERIMENTAL_FRAMES,
    MAX_HASHES,
    MAX_WRAPPED,
    RECOMMENDED_HASHES,
    Evidence,
    Link,
    Manifest,
    SamMessage,
    SamType,
    UnsupportedMethodError,
    decode_manifest,
    decode_sam,
    decode_wrapped,
    encode_manifest,
    encode_sam,
    encode_wrapped,
    link_hash,
    since_2019_s,
)
from skyrange.codec.drip.pages import MAX_AUTH_DATA, join_with_parity, page_count, split_with_parity

__all__ = [
    "APEX_HID",
    "EDDSA_CSHAKE128",
    "EXPERIMENTAL_FRAMES",
    "HASH_BYTES",
    "KEY_BYTES",
    "MAX_AUTH_DATA",
    "MAX_HASHES",
    "MAX_WRAPPED",
    "RECOMMENDED_HASHES",
    "TAG_BYTES",
    "EntityTag",
    "Evidence",
    "Link",
    "Manifest",
    "SamMessage",
    "SamType",
    "UnsupportedMethodError",
    "decode_manifest",
    "decode_sam",
    "decode_wrapped",
    "encode_manifest",
    "encode_sam",
    "encode_wrapped",
    "join_with_parity",
    "link_hash",
    "message_hash",
    "page_count",
    "pages_hash",
    "parse_session_id",
    "session_id",
    "since_2019_s",
    "split_with_parity",
]
