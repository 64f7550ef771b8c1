// SPDX-License-Identifier: MIT
#include "mac.h"

#include "chance.h"

#include "inet/common/ProtocolTag_m.h"
#include "inet/common/packet/Packet.h"
#include "inet/common/packet/chunk/ByteCountChunk.h"
#include "inet/linklayer/common/MacAddressTag_m.h"
#include "inet/linklayer/ieee80211/mac/Ieee80211Frame_m.h"
#include "inet/linklayer/ieee80211/mac/Ieee80211SubtypeTag_m.h"
#include "inet/linklayer/ieee80211/mib/Ieee80211Mib.h"
#include "inet/physicallayer/wireless/common/contract/packetlevel/SignalTag_m.h"

#include <cmath>

using namespace inet;
using namespace omnetpp;
using namespace medium_protocol;

namespace skyrange
{

namespace
{

// A frame that has waited for access so long is dropped, as skyrange's medium contract says.
const int64_t kMaxWaitNs = 500'000'000;
// MAC header of a management frame, and the check sequence; INET adds both.
const int64_t kHeaderBytes = 24;
const int64_t kCheckBytes = 4;

} // namespace

Define_Module(PlacedMobility);
Define_Module(AddressedContention);
Define_Module(FrameSource);
Define_Module(FrameQueue);

const Coord&
PlacedMobility::getCurrentPosition()
{
    return m_radio == kNoRadio ? Coord::ZERO : TheAir().places[m_radio];
}

void
AddressedContention::Address(uint64_t stream, uint16_t channel, uint16_t waveform)
{
    m_stream = stream;
    m_interface = uint64_t(channel) << 16 | waveform;
}

void
AddressedContention::initialize(int stage)
{
    Contention::initialize(stage);
    if (stage == INITSTAGE_LAST && mediumFree)
    {
        // an interface that is made while the range runs has been idle, as at the start of a simulation
        lastChannelBusyTime = lastIdleStartTime = simTime() - SimTime::getMaxTime() / 2;
    }
}

uint32_t
AddressedContention::intrand(uint32_t range, int) const
{
    const auto& hello = TheAir().hello;
    return uint32_t(AddressedUniform({hello.seed, m_stream, m_interface, uint64_t(simTime().raw())}) * range);
}

void
AddressedContention::Cancel()
{
    Enter_Method("Cancel");
    cancelEvent(startTxEvent);
    cancelEvent(channelGrantedEvent);
    fsm.setState(IDLE, "IDLE");
}

void
FrameSource::initialize(int stage)
{
    if (stage == INITSTAGE_LINK_LAYER)
    {
        cModule* access = getParentModule()->getModuleByPath(".mac.dcf.channelAccess");
        m_queue = check_and_cast<queueing::IPacketQueue*>(access->getSubmodule("pendingQueue"));
        m_contention = check_and_cast<AddressedContention*>(access->getSubmodule("contention"));
        auto mib = check_and_cast<ieee80211::Ieee80211Mib*>(getModuleByPath(par("mibModule")));
        mib->mode = ieee80211::Ieee80211Mib::INDEPENDENT; // the MAC knows no other mode without an association
    }
}

void
FrameSource::Send(int64_t key)
{
    Enter_Method("Send");
    const Transmission& request = TheAir().frames.at(key).request;
    auto packet = new Packet(std::to_string(key).c_str());
    const int64_t payload = request.size_bytes - kHeaderBytes - kCheckBytes;
    if (payload > 0)
    {
        packet->insertAtBack(makeShared<ByteCountChunk>(B(payload)));
    }
    packet->addTag<PacketProtocolTag>()->setProtocol(&Protocol::ieee80211Mgmt);
    packet->addTag<Ieee80211SubtypeReq>()->setSubtype(ieee80211::ST_BEACON);
    packet->addTag<MacAddressReq>()->setDestAddress(MacAddress::BROADCAST_ADDRESS);
    packet->addTag<SignalPowerReq>()->setPower(mW(std::pow(10.0, 0.1 * request.power_dbm)));
    send(packet, "macOut");
}

void
FrameSource::Withdraw()
{
    Enter_Method("Withdraw");
    while (m_queue->getNumPackets() > 0)
    {
        delete m_queue->dequeuePacket();
    }
    m_contention->Cancel();
}

FrameQueue::~FrameQueue()
{
    cancelAndDelete(m_deadline);
}

void
FrameQueue::initialize()
{
    m_deadline = new cMessage("deadline");
    m_deadline->setSchedulingPriority(-1); // a frame that waited so long is not sent at that very time
}

void
FrameQueue::Offer(int64_t key, FrameSource* source)
{
    Enter_Method("Offer");
    m_waiting.push_back({key, source, simTime() + SimTime(kMaxWaitNs, SIMTIME_NS)});
    if (m_waiting.size() == 1)
    {
        GiveUp();
    }
}

void
FrameQueue::handleMessage(cMessage*)
{
    GiveUp();
}

/// Give up the frames that have waited too long, unless one is on the air, and go on with the next one.
void
FrameQueue::GiveUp()
{
    const int64_t now = TheAir().ToNs(simTime());
    cancelEvent(m_deadline);
    while (!m_waiting.empty() && m_waiting.front().deadline <= simTime() && !m_started)
    {
        const Waiting late = m_waiting.front();
        m_waiting.pop_front();
        if (m_handed_over)
        {
            late.source->Withdraw();
            m_handed_over = false;
        }
        TheAir().TellSent(late.key, now, now, NO_ACCESS);
    }
    if (!m_waiting.empty() && !m_started)
    {
        scheduleAt(m_waiting.front().deadline, m_deadline);
        HandOver();
    }
}

void
FrameQueue::HandOver()
{
    if (!m_handed_over)
    {
        m_handed_over = true;
        m_waiting.front().source->Send(m_waiting.front().key);
    }
}

void
FrameQueue::OnStart(int64_t key)
{
    Enter_Method("OnStart");
    if (m_waiting.empty() || m_waiting.front().key != key)
    {
        throw cRuntimeError("a frame was sent that no one offered");
    }
    m_started = true;
}

void
FrameQueue::OnEnd()
{
    Enter_Method("OnEnd");
    m_waiting.pop_front();
    m_handed_over = false;
    m_started = false;
    GiveUp();
}

} // namespace skyrange
