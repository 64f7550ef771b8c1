// What is on the air: the frames under way, where the radios are, and the rows of the next answer.
// SPDX-License-Identifier: MIT
#ifndef SKYRANGE_OMNETPP_AIR_H
#define SKYRANGE_OMNETPP_AIR_H

#include "../common/medium_protocol.h"
#include "settings.h"

#include "inet/common/geometry/common/Coord.h"

#include <deque>
#include <map>
#include <omnetpp.h>
#include <unordered_map>

namespace skyrange
{

class ListedMedium;
class PathProbe;
class ObservedRadio;

/// A frame from its transmission request until nothing more can be told of it.
struct Frame
{
    medium_protocol::Transmission request;
    std::vector<medium_protocol::Path> paths;
    uint32_t receptions = 0; // that have not ended
    bool ended = false;
};

/// Noise at a radio: of a jammer, or of traffic that is not simulated.
struct NoisePiece
{
    omnetpp::simtime_t from;
    omnetpp::simtime_t to; // not any more
    double centre_mhz;
    double width_mhz;
    double power_dbm; // at the receiver's input
};

/// Everything that the modules of the engine share. There is one engine in a process.
struct Air
{
    medium_protocol::Hello hello;
    Settings settings;
    ListedMedium* medium = nullptr;
    PathProbe* probe = nullptr;
    std::unordered_map<int64_t, Frame> frames; // by key
    std::vector<inet::Coord> places;           // by radio: the last one that is known
    std::vector<bool> present;                 // by radio
    std::vector<std::vector<ObservedRadio*>> interfaces; // by radio
    std::vector<std::deque<NoisePiece>> noise;           // by radio
    std::vector<medium_protocol::SentRow> sent;
    std::vector<medium_protocol::HeardRow> heard;

    /// The time of the range in ns. OMNeT++ counts from `origin_ns`, because it has no negative times.
    int64_t ToNs(omnetpp::simtime_t time) const
    {
        return time.inUnit(omnetpp::SIMTIME_NS) + hello.origin_ns;
    }

    omnetpp::simtime_t ToSimTime(int64_t time_ns) const
    {
        return omnetpp::SimTime(time_ns - hello.origin_ns, omnetpp::SIMTIME_NS);
    }

    /// Propagation delay between two radios in whole nanoseconds, so that everything happens at whole nanoseconds; 0 if
    /// one of them has no place.
    omnetpp::simtime_t Delay(uint32_t sender, uint32_t receiver) const;

    /// Tell that a frame was sent, or given up at `ended_ns`.
    void TellSent(int64_t key, int64_t started_ns, int64_t ended_ns, medium_protocol::Fate fate);

    /// Tell of one reception of a frame, and forget the frame after the last one.
    void TellHeard(int64_t key, const medium_protocol::HeardRow& row);

    void Forget(int64_t key);
};

/// The one of this process.
Air& TheAir();

/// Key of a frame from the name of its packet, which INET keeps on all copies.
int64_t KeyOf(const omnetpp::cObject* packet);

} // namespace skyrange

#endif
