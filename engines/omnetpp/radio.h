// The physical layer of a radio interface: a radio that tells what became of each reception.
// SPDX-License-Identifier: MIT
#ifndef SKYRANGE_OMNETPP_RADIO_H
#define SKYRANGE_OMNETPP_RADIO_H

#include "air.h"
#include "mac.h"

#include "inet/physicallayer/wireless/common/contract/packetlevel/IBackgroundNoise.h"
#include "inet/physicallayer/wireless/ieee80211/packetlevel/Ieee80211Radio.h"
#include "inet/physicallayer/wireless/ieee80211/packetlevel/Ieee80211ScalarReceiver.h"

namespace skyrange
{

/// Which interface a module belongs to.
struct InterfaceAddress
{
    uint32_t radio = 0;
    uint16_t channel = 0;
    uint16_t waveform = 0;
    uint64_t stream = 0;
};

class ObservedRadio : public inet::physicallayer::Ieee80211Radio
{
  public:
    InterfaceAddress address;
    FrameSource* source = nullptr;
    FrameQueue* queue = nullptr; // of all interfaces of the radio

    /// Sense noise from now on: INET refuses a receiver that is busy when it is made.
    void Listen();

    /// Noise that is strong enough to make the channel busy begins or ends.
    void OnNoise();

    bool Listens() const
    {
        return m_listens;
    }

    inet::physicallayer::Hz CentreFrequency() const;
    inet::physicallayer::Hz Bandwidth() const;

  protected:
    void startTransmission(inet::Packet* frame, inet::physicallayer::IRadioSignal::SignalPart part) override;
    void endTransmission() override;
    void startReception(omnetpp::cMessage* timer, inet::physicallayer::IRadioSignal::SignalPart part) override;
    void endReception(omnetpp::cMessage* timer) override;
    void sendUp(inet::Packet* frame) override;

  private:
    medium_protocol::Outcome OutcomeOf(omnetpp::cMessage* timer) const;
    bool SendsElsewhere() const;

    bool m_listens = false;
};

/// INET's receiver, with a draw that depends on both radios and the time alone.
class AddressedReceiver : public inet::physicallayer::Ieee80211ScalarReceiver
{
  public:
    /// Whether the frame would have been decoded without other signals.
    bool DecodesAlone(const inet::physicallayer::IListening* listening,
                      const inet::physicallayer::IReception* reception) const;

    bool IsStrongEnough(const inet::physicallayer::IListening* listening,
                        const inet::physicallayer::IReception* reception) const
    {
        return computeIsReceptionPossible(listening, reception, inet::physicallayer::IRadioSignal::SIGNAL_PART_WHOLE);
    }

  protected:
    using Ieee80211ScalarReceiver::computeIsReceptionPossible;
    bool computeIsReceptionPossible(const inet::physicallayer::IListening* listening,
                                    const inet::physicallayer::IReception* reception,
                                    inet::physicallayer::IRadioSignal::SignalPart part) const override;
    bool computeIsReceptionSuccessful(const inet::physicallayer::IListening* listening,
                                      const inet::physicallayer::IReception* reception,
                                      inet::physicallayer::IRadioSignal::SignalPart part,
                                      const inet::physicallayer::IInterference* interference,
                                      const inet::physicallayer::ISnir* snir) const override;

  private:
    bool Decodes(const inet::physicallayer::IReception* reception, const inet::physicallayer::ISnir* snir) const;
};

/// Thermal noise at 290 K in the receiver's band times the radio's noise figure, and the share of all noise in that band.
class ReceiverNoise : public omnetpp::cModule, public inet::physicallayer::IBackgroundNoise
{
  public:
    const inet::physicallayer::INoise* computeNoise(
        const inet::physicallayer::IListening* listening) const override;

    /// The thermal noise alone.
    const inet::physicallayer::INoise* ThermalNoise(const inet::physicallayer::IListening* listening) const;
};

} // namespace skyrange

#endif
