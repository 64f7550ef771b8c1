// What is on the air: the frames under way, the power at which each reaches a radio, and what became of them.
// SPDX-License-Identifier: MIT
#ifndef SKYRANGE_NS3_AIR_H
#define SKYRANGE_NS3_AIR_H

#include "../common/medium_protocol.h"

#include "ns3/mobility-model.h"
#include "ns3/nstime.h"
#include "ns3/propagation-loss-model.h"
#include "ns3/simulator.h"

#include <memory>
#include <unordered_map>
#include <vector>

namespace skyrange
{

/// A frame from its transmission request until nothing more can be told of it.
struct Frame
{
    medium_protocol::Transmission request;
    std::vector<medium_protocol::Path> paths;
    bool handed_over = false; // to the MAC
    bool started = false;
};

/// The frames under way and the rows of the next answer; shared by all parts of the engine.
struct Air
{
    medium_protocol::Hello hello;
    std::unordered_map<int64_t, std::shared_ptr<Frame>> frames; // by key
    std::vector<ns3::Ptr<ns3::MobilityModel>> mobility;         // by radio
    std::vector<bool> present;                                  // by radio
    ns3::Ptr<ns3::PropagationLossModel> losses;                 // null if skyrange computes them
    std::vector<medium_protocol::SentRow> sent;
    std::vector<medium_protocol::HeardRow> heard;

    /// The time of the range, in ns. ns-3 counts from `origin_ns`, because it has no negative times.
    int64_t NowNs() const
    {
        return ns3::Simulator::Now().GetNanoSeconds() + hello.origin_ns;
    }

    /// Power at the receiver's input over power into the sender's antenna, in dB.
    double GainDb(uint32_t sender, const medium_protocol::Path& path) const
    {
        if (!losses || sender == medium_protocol::kNoRadio)
        {
            return path.gain_db;
        }
        return path.gain_db + losses->CalcRxPower(0.0, mobility[sender], mobility[path.radio]);
    }

    /// Propagation delay between two radios, in whole nanoseconds; 0 if one of them has no place.
    ns3::Time Delay(uint32_t sender, uint32_t receiver) const
    {
        if (sender == medium_protocol::kNoRadio || !present[sender] || !present[receiver])
        {
            return ns3::Time(0);
        }
        const double distance_m = mobility[sender]->GetDistanceFrom(mobility[receiver]);
        return ns3::NanoSeconds(int64_t(distance_m / 0.299792458));
    }
};

} // namespace skyrange

#endif
