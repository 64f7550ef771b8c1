// SPDX-License-Identifier: MIT
#include "air.h"

#include <cmath>
#include <cstdlib>

using namespace medium_protocol;

namespace skyrange
{

namespace
{

const double kLightMetresPerNs = 0.299792458;

} // namespace

Air&
TheAir()
{
    static Air air;
    return air;
}

int64_t
KeyOf(const omnetpp::cObject* packet)
{
    return std::strtoll(packet->getName(), nullptr, 10);
}

omnetpp::simtime_t
Air::Delay(uint32_t sender, uint32_t receiver) const
{
    if (sender == kNoRadio || !present[sender] || !present[receiver])
    {
        return 0;
    }
    const double distance_m = places[sender].distance(places[receiver]);
    return omnetpp::SimTime(int64_t(distance_m / kLightMetresPerNs), omnetpp::SIMTIME_NS);
}

void
Air::TellSent(int64_t key, int64_t started_ns, int64_t ended_ns, Fate fate)
{
    Frame& frame = frames.at(key);
    sent.push_back({key, started_ns, ended_ns, frame.request.radio, frame.request.channel, fate});
    frame.ended = true;
    Forget(key);
}

void
Air::TellHeard(int64_t key, const HeardRow& row)
{
    heard.push_back(row);
    frames.at(key).receptions--;
    Forget(key);
}

void
Air::Forget(int64_t key)
{
    const Frame& frame = frames.at(key);
    if (frame.ended && frame.receptions == 0)
    {
        frames.erase(key);
    }
}

} // namespace skyrange
