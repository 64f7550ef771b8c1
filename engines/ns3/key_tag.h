// Tag of an ns-3 packet with the key of its frame.
// SPDX-License-Identifier: MIT
#ifndef SKYRANGE_NS3_KEY_TAG_H
#define SKYRANGE_NS3_KEY_TAG_H

#include "ns3/packet.h"
#include "ns3/tag.h"

#include <cstdint>
#include <optional>

namespace skyrange
{

class KeyTag : public ns3::Tag
{
  public:
    static ns3::TypeId GetTypeId()
    {
        static ns3::TypeId id = ns3::TypeId("skyrange::KeyTag").SetParent<ns3::Tag>().AddConstructor<KeyTag>();
        return id;
    }

    ns3::TypeId GetInstanceTypeId() const override
    {
        return GetTypeId();
    }

    uint32_t GetSerializedSize() const override
    {
        return sizeof(uint64_t);
    }

    void Serialize(ns3::TagBuffer buffer) const override
    {
        buffer.WriteU64(uint64_t(key));
    }

    void Deserialize(ns3::TagBuffer buffer) override
    {
        key = int64_t(buffer.ReadU64());
    }

    void Print(std::ostream& out) const override
    {
        out << key;
    }

    int64_t key = -1;
};

/// The key of a packet's frame, if it has one.
inline std::optional<int64_t>
KeyOf(ns3::Ptr<const ns3::Packet> packet)
{
    KeyTag tag;
    if (!packet->PeekPacketTag(tag))
    {
        return std::nullopt;
    }
    return tag.key;
}

} // namespace skyrange

#endif
