// A radio medium in which a frame reaches the radios that it lists, each with the power that belongs to it.
// SPDX-License-Identifier: MIT
#ifndef SKYRANGE_OMNETPP_MEDIUM_H
#define SKYRANGE_OMNETPP_MEDIUM_H

#include "air.h"
#include "radio.h"

#include "inet/physicallayer/wireless/common/analogmodel/packetlevel/ScalarAnalogModel.h"
#include "inet/physicallayer/wireless/common/base/packetlevel/TransmitterBase.h"
#include "inet/physicallayer/wireless/common/medium/RadioMedium.h"
#include "inet/physicallayer/wireless/noise/NoiseSource.h"

#include <unordered_map>

namespace skyrange
{

/// Share of a flat spectrum that falls into the band of a receiver.
double Overlap(inet::physicallayer::Hz centre,
               inet::physicallayer::Hz width,
               inet::physicallayer::Hz receiver_centre,
               inet::physicallayer::Hz receiver_width);

/// Which radios a transmission reaches, and at which power.
struct Reach
{
    int64_t key = 0;
    uint32_t sender = 0;
    uint16_t channel = 0;
    uint16_t waveform = 0;
    double power_dbm = 0.0;
    std::vector<medium_protocol::Path> paths;              // as requested
    std::vector<std::pair<uint32_t, double>> receivers_dbm; // radios in ascending order, dBm at their inputs

    double PowerDbm(uint32_t radio) const;
    bool Has(uint32_t radio) const;
};

class ListedMedium : public inet::physicallayer::RadioMedium
{
  public:
    const Reach& ReachOf(const inet::physicallayer::ITransmission* transmission) const
    {
        return m_reaches.at(transmission->getId());
    }

    inet::physicallayer::IWirelessSignal* transmitPacket(const inet::physicallayer::IRadio* radio,
                                                         inet::Packet* packet) override;

    void addRadio(const inet::physicallayer::IRadio* radio) override;

    /// Let a new interface sense what is on the air already.
    void PickUp(ObservedRadio* radio);

    /// Basic transmission loss between two places with INET's models, in dB; NaN if skyrange computes the losses.
    double LossDb(const inet::Coord& from, const inet::Coord& to, double frequency_hz) const;

  protected:
    void addTransmission(const inet::physicallayer::IRadio* radio,
                         const inet::physicallayer::ITransmission* transmission) override;
    void sendToAffectedRadios(inet::physicallayer::IRadio* radio,
                              const inet::physicallayer::IWirelessSignal* signal) override;
    void removeNonInterferingTransmissions() override;

  private:
    const inet::physicallayer::IArrival* Arrive(const Reach& reach,
                                                const inet::physicallayer::ITransmission* transmission,
                                                uint32_t receiver) const;
    void Connect(const inet::physicallayer::ITransmission* transmission, const ObservedRadio* receiver);
    std::vector<ObservedRadio*> Receivers(const Reach& reach,
                                          const inet::physicallayer::ITransmission* transmission) const;
    void AddReceivers(Reach& reach, const inet::physicallayer::ITransmission* transmission) const;

    Reach m_next;
    std::unordered_map<int, Reach> m_reaches; // by transmission
    std::vector<ObservedRadio*> m_receivers;  // of the transmission that begins
};

/// Received power as the requests say it; the share of it that falls into the receiver's band.
class GivenPowerAnalogModel : public inet::physicallayer::ScalarAnalogModel
{
  public:
    const inet::physicallayer::IReception* computeReception(
        const inet::physicallayer::IRadio* radio,
        const inet::physicallayer::ITransmission* transmission,
        const inet::physicallayer::IArrival* arrival) const override;
};

/// What INET's propagation models take for the sender of a path whose loss is asked for.
class PathProbe : public inet::physicallayer::NoiseSource
{
  protected:
    void scheduleSleepTimer() override
    {
    }
};

class ProbeTransmitter : public inet::physicallayer::TransmitterBase
{
  public:
    const inet::physicallayer::ITransmission* createTransmission(const inet::physicallayer::IRadio*,
                                                                 const inet::Packet*,
                                                                 omnetpp::simtime_t) const override
    {
        throw omnetpp::cRuntimeError("a probe does not transmit");
    }
};

} // namespace skyrange

#endif
