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

/// The place of INET's management in an interface: hands a frame to the MAC, or takes it back.
class FrameSource : public omnetpp::cSimpleModule
{
  public:
    void Send(int64_t key);

    /// Take the frame that contends for access back from the MAC.
    void Withdraw();

  protected:
    int numInitStages() const override
    {
        return inet::NUM_INIT_STAGES;
    }

    void initialize(int stage) override;

    void handleMessage(omnetpp::cMessage* message) override
    {
        delete message; // nothing comes from the MAC that the radio has not told of
    }

  private:
    inet::queueing::IPacketQueue* m_queue = nullptr; // of the MAC
    AddressedContention* m_contention = nullptr;
};

/// The frames of a radio, which sends one at a time whatever its channel, and gives up those that wait too long.
class FrameQueue : public omnetpp::cSimpleModule
{
  public:
    ~FrameQueue() override;

    /// Take a frame to be sent by `source` now, or after those that wait.
    void Offer(int64_t key, FrameSource* source);

    void OnStart(int64_t key);
    void OnEnd();

  protected:
    void initialize() override;
    void handleMessage(omnetpp::cMessage* message) override;

  private:
    struct Waiting
    {
        int64_t key;
        FrameSource* source;
        omnetpp::simtime_t deadline;
    };

    void GiveUp();
    void HandOver();

    std::deque<Waiting> m_waiting; // the first one is with the MAC if it was handed over
    bool m_handed_over = false;
    bool m_started = false;
    omnetpp::cMessage* m_deadline = nullptr;
};

} // namespace skyrange

#endif
