// SPDX-License-Identifier: MIT
#include "radio.h"

#include "chance.h"
#include "medium.h"

#include "inet/physicallayer/wireless/common/analogmodel/packetlevel/ScalarNoise.h"
#include "inet/physicallayer/wireless/common/contract/packetlevel/IRadioMedium.h"
#include "inet/physicallayer/wireless/common/radio/packetlevel/BandListening.h"
#include "inet/physicallayer/wireless/common/signal/Interference.h"

#include <cmath>
#include <map>
#include <memory>

using namespace inet;
using namespace inet::physicallayer;
using namespace omnetpp;
using namespace medium_protocol;

namespace skyrange
{

namespace
{

const double kBoltzmann = 1.380649e-23; // J/K, exact (SI)
const double kTemperatureK = 290.0;     // to which noise figures refer (IEEE Std 161)

// What a reception is until it ends: kept in the timer's context pointer, which INET leaves alone.
void
SetFate(cMessage* timer, Outcome fate)
{
    timer->setContextPointer(reinterpret_cast<void*>(intptr_t(fate)));
}

W
ThermalPower(const IListening* listening)
{
    const auto band = check_and_cast<const BandListening*>(listening);
    const auto radio = check_and_cast<const ObservedRadio*>(listening->getReceiver())->address.radio;
    const double factor = std::pow(10.0, 0.1 * TheAir().hello.radios[radio].noise_figure_db);
    return W(kBoltzmann * kTemperatureK * band->getBandwidth().get() * factor);
}

} // namespace

Define_Module(ObservedRadio);
Define_Module(AddressedReceiver);
Define_Module(ReceiverNoise);

Hz
ObservedRadio::CentreFrequency() const
{
    return check_and_cast<const NarrowbandReceiverBase*>(receiver)->getCenterFrequency();
}

Hz
ObservedRadio::Bandwidth() const
{
    return check_and_cast<const NarrowbandReceiverBase*>(receiver)->getBandwidth();
}

void
ObservedRadio::Listen()
{
    m_listens = true;
    OnNoise();
}

void
ObservedRadio::OnNoise()
{
    Enter_Method("OnNoise");
    updateTransceiverState();
}

void
ObservedRadio::startTransmission(Packet* frame, IRadioSignal::SignalPart part)
{
    queue->OnStart(KeyOf(frame));
    Ieee80211Radio::startTransmission(frame, part);
}

void
ObservedRadio::endTransmission()
{
    const auto signal = static_cast<const WirelessSignal*>(transmissionTimer->getContextPointer());
    const int64_t key = TheAir().medium->ReachOf(signal->getTransmission()).key;
    const int64_t started_ns = TheAir().ToNs(signal->getTransmission()->getStartTime());
    Ieee80211Radio::endTransmission();
    TheAir().TellSent(key, started_ns, TheAir().ToNs(simTime()), SENT);
    queue->OnEnd();
}

void
ObservedRadio::startReception(cMessage* timer, IRadioSignal::SignalPart part)
{
    const bool sending = !isReceiverMode(radioMode) || SendsElsewhere();
    const bool locked = receptionTimer != nullptr;
    Ieee80211Radio::startReception(timer, part);
    // DECODED stands for a reception that was begun
    SetFate(timer, sending ? SENDING : receptionTimer == timer ? DECODED : locked ? BUSY : WEAK);
}

bool
ObservedRadio::SendsElsewhere() const
{
    for (const ObservedRadio* other : TheAir().interfaces[address.radio])
    {
        if (other->getTransmissionInProgress() != nullptr)
        {
            return true;
        }
    }
    return false;
}

Outcome
ObservedRadio::OutcomeOf(cMessage* timer) const
{
    const auto signal = static_cast<const WirelessSignal*>(timer->getControlInfo());
    const auto transmission = signal->getTransmission();
    const auto listening = signal->getListening();
    const auto reception = signal->getReception();
    const auto addressed = check_and_cast<const AddressedReceiver*>(receiver);
    const auto fate = Outcome(reinterpret_cast<intptr_t>(timer->getContextPointer()));
    if (fate == SENDING)
    {
        return SENDING;
    }
    if (!addressed->IsStrongEnough(listening, reception))
    {
        return WEAK;
    }
    if (fate != DECODED)
    {
        return fate;
    }
    if (timer != receptionTimer || SendsElsewhere())
    {
        return SENDING; // it was aborted for a transmission
    }
    if (medium->getReceptionDecision(this, listening, transmission, IRadioSignal::SIGNAL_PART_WHOLE)
            ->isReceptionSuccessful())
    {
        return DECODED;
    }
    return addressed->DecodesAlone(listening, reception) ? COLLIDED : WEAK;
}

void
ObservedRadio::endReception(cMessage* timer)
{
    const auto signal = static_cast<const WirelessSignal*>(timer->getControlInfo());
    const auto transmission = signal->getTransmission();
    const Reach& reach = TheAir().medium->ReachOf(transmission);
    if (reach.channel == address.channel && reach.waveform == address.waveform)
    {
        const double snir_db = 10.0 * std::log10(medium->getSNIR(this, transmission)->getMin());
        const int64_t now = TheAir().ToNs(simTime());
        const HeardRow row{reach.key,     now,           reach.PowerDbm(address.radio),
                           snir_db,       address.radio, address.channel,
                           OutcomeOf(timer)};
        Ieee80211Radio::endReception(timer);
        TheAir().TellHeard(row.key, row);
    }
    else
    {
        Ieee80211Radio::endReception(timer);
    }
}

/// Only what was not decoded concerns the MAC (EIFS): frames to all set no NAV and are not answered.
void
ObservedRadio::sendUp(Packet* frame)
{
    if (frame->hasBitError())
    {
        Ieee80211Radio::sendUp(frame);
    }
    else
    {
        delete frame;
    }
}

bool
AddressedReceiver::computeIsReceptionPossible(const IListening* listening,
                                              const IReception* reception,
                                              IRadioSignal::SignalPart part) const
{
    // what arrives from another channel has been moved into this band by the medium, as interference
    const auto sent = dynamic_cast<const INarrowbandSignal*>(reception->getTransmission()->getAnalogModel());
    return sent != nullptr && sent->getCenterFrequency() == centerFrequency &&
           Ieee80211ScalarReceiver::computeIsReceptionPossible(listening, reception, part);
}

bool
AddressedReceiver::computeIsReceptionSuccessful(const IListening*,
                                                const IReception* reception,
                                                IRadioSignal::SignalPart,
                                                const IInterference*,
                                                const ISnir* snir) const
{
    return Decodes(reception, snir);
}

/// INET's rule (SnirReceiverBase and FlatReceiverBase), but for the draw.
bool
AddressedReceiver::Decodes(const IReception* reception, const ISnir* snir) const
{
    if (!((snirThresholdMode == SnirThresholdMode::STM_MEAN ? snir->getMean() : snir->getMin()) > snirThreshold))
    {
        return false;
    }
    const auto transmission = reception->getTransmission();
    const auto& to = check_and_cast<const ObservedRadio*>(reception->getReceiver())->address;
    const auto& from = check_and_cast<const ObservedRadio*>(transmission->getTransmitter())->address;
    const double draw = AddressedUniform({TheAir().hello.seed, to.stream, from.stream,
                                          uint64_t(from.channel) << 16 | from.waveform,
                                          uint64_t(transmission->getStartTime().raw())});
    return draw >= errorModel->computePacketErrorRate(snir, IRadioSignal::SIGNAL_PART_WHOLE);
}

bool
AddressedReceiver::DecodesAlone(const IListening* listening, const IReception* reception) const
{
    const auto medium = reception->getReceiver()->getMedium();
    const auto thermal = check_and_cast<const ReceiverNoise*>(medium->getBackgroundNoise());
    const Interference quiet(thermal->ThermalNoise(listening), new std::vector<const IReception*>());
    const std::unique_ptr<const INoise> noise(medium->getAnalogModel()->computeNoise(listening, &quiet));
    const std::unique_ptr<const ISnir> snir(medium->getAnalogModel()->computeSNIR(reception, noise.get()));
    return Decodes(reception, snir.get());
}

const INoise*
ReceiverNoise::ThermalNoise(const IListening* listening) const
{
    const auto band = check_and_cast<const BandListening*>(listening);
    const auto& shape = makeShared<math::Boxcar1DFunction<W, simtime_t>>(
        listening->getStartTime(), listening->getEndTime(), ThermalPower(listening));
    return new ScalarNoise(listening->getStartTime(), listening->getEndTime(), band->getCenterFrequency(),
                           band->getBandwidth(), shape);
}

const INoise*
ReceiverNoise::computeNoise(const IListening* listening) const
{
    const auto radio = check_and_cast<const ObservedRadio*>(listening->getReceiver());
    const auto band = check_and_cast<const BandListening*>(listening);
    const simtime_t start = listening->getStartTime();
    const simtime_t end = listening->getEndTime();
    std::vector<std::pair<const NoisePiece*, W>> pieces;
    std::map<simtime_t, W> power;
    for (const NoisePiece& piece : TheAir().noise[radio->address.radio])
    {
        const double share = Overlap(MHz(piece.centre_mhz), MHz(piece.width_mhz), band->getCenterFrequency(),
                                     band->getBandwidth());
        if (radio->Listens() && share > 0.0 && piece.from <= end && piece.to > start)
        {
            pieces.emplace_back(&piece, mW(std::pow(10.0, 0.1 * piece.power_dbm) * share));
            power[std::max(piece.from, start)] = W(0);
            power[std::min(piece.to, end)] = W(0);
        }
    }
    if (pieces.empty())
    {
        return ThermalNoise(listening);
    }
    power[start] = W(0);
    for (auto& [time, sum] : power)
    {
        sum = ThermalPower(listening);
        for (const auto& [piece, level] : pieces)
        {
            sum += piece->from <= time && time < piece->to ? level : W(0);
        }
    }
    power[math::getLowerBound<simtime_t>()] = W(0);
    power[math::getUpperBound<simtime_t>()] = W(0);
    power[end] = W(0);
    const auto& shape = makeShared<math::Interpolated1DFunction<W, simtime_t>>(
        power, &math::LeftInterpolator<simtime_t, W>::singleton);
    return new ScalarNoise(start, end, band->getCenterFrequency(), band->getBandwidth(), shape);
}

} // namespace skyrange
