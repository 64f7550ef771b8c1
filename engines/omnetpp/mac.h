// The link layer of a radio interface: a source of frames in the place of INET's management, and addressed backoff.
// SPDX-License-Identifier: MIT
#ifndef SKYRANGE_OMNETPP_MAC_H
#define SKYRANGE_OMNETPP_MAC_H

#include "air.h"

#include "inet/linklayer/ieee80211/mac/contention/Contention.h"
#include "inet/mobility/base/MobilityBase.h"
#include "inet/queueing/contract/IPacketQueue.h"

#include <deque>

namespace skyrange
{

class ObservedRadio;

/// The place of a radio, as the requests say it.
class PlacedMobility : public inet::MobilityBase
{
  public:
    void Place(uint32_t radio)
    {
        m_radio = radio;
    }

    double getMaxSpeed() const override
    {
        return 0.0;
    }

    const inet::Coord& getCurrentPosition() override;

    const inet::Coord& getCurrentVelocity() override
    {
        return inet::Coord::ZERO;
    }

    const inet::Coord& getCurrentAcceleration() override
    {
        return inet::Coord::ZERO;
    }

    const inet::Quaternion& getCurrentAngularPosition() override
    {
        return inet::Quaternion::IDENTITY;
    }

    const inet::Quaternion& getCurrentAngularVelocity() override
    {
        return inet::Quaternion::IDENTITY;
    }

    const inet::Quaternion& getCurrentAngularAcceleration() override
    {
        return inet::Quaternion::IDENTITY;
    }

    const inet::Coord& getConstraintAreaMax() const override
    {
        return inet::Coord::ZERO;
    }

    const inet::Coord& getConstraintAreaMin() const override
    {
        return inet::Coord::ZERO;
    }

  protected:
    void setInitialPosition() override
    {
    }

    void handleSelfMessage(omnetpp::cMessage*) override
    {
    }

  private:
    uint32_t m_radio = medium_protocol::kNoRadio;
};

/// INET's contention, with a backoff that depends on the radio and the time alone.
class AddressedContention : public inet::ieee80211::Contention
{
  public:
    void Address(uint64_t stream, uint16_t channel, uint16_t waveform);

    /// Stop contending, because the frame was given up.
    void Cancel();

  protected:
    void initialize(int stage) override;
    uint32_t intrand(uint32_t range, int rng = 0) const override;

  private:
    uint64_t m_stream = 0;
    uint64_t m_interface = 0;
};

/// Hands the frames of a radio to the MAC, one after the other, and gives up those that wait too long.
class FrameSource : public omnetpp::cSimpleModule
{
  public:
    ~FrameSource() override;

    /// Take a frame to be sent now, or after those that wait.
    void Offer(int64_t key);

    void OnStart(int64_t key);
    void OnEnd();

  protected:
    int numInitStages() const override
    {
        return inet::NUM_INIT_STAGES;
    }

    void initialize(int stage) override;
    void handleMessage(omnetpp::cMessage* message) override;

  private:
    void HandOver();
    void GiveUp();
    void Withdraw();

    omnetpp::cMessage* m_deadline = nullptr;
    inet::queueing::IPacketQueue* m_queue = nullptr; // of the MAC
    AddressedContention* m_contention = nullptr;
    std::deque<std::pair<int64_t, omnetpp::simtime_t>> m_waiting; // key, deadline; the first one is with the MAC
    bool m_handed_over = false;
    bool m_started = false;
};

} // namespace skyrange

#endif
