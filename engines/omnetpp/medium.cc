// SPDX-License-Identifier: MIT
#include "medium.h"

#include "inet/common/INETUtils.h"
#include "inet/common/IntervalTree.h"
#include "inet/common/packet/Packet.h"
#include "inet/physicallayer/wireless/common/analogmodel/packetlevel/ScalarReception.h"
#include "inet/physicallayer/wireless/common/analogmodel/packetlevel/ScalarTransmission.h"
#include "inet/physicallayer/wireless/common/signal/Arrival.h"

#include <algorithm>
#include <cmath>

using namespace inet;
using namespace inet::physicallayer;
using namespace omnetpp;
using namespace medium_protocol;

namespace skyrange
{

namespace
{

double
Decibels(double ratio)
{
    return 10.0 * std::log10(ratio);
}

const INarrowbandSignal*
BandOf(const ITransmission* transmission)
{
    return check_and_cast<const INarrowbandSignal*>(transmission->getAnalogModel());
}

} // namespace

Define_Module(ListedMedium);
Define_Module(GivenPowerAnalogModel);
Define_Module(PathProbe);
Define_Module(ProbeTransmitter);

double
Overlap(Hz centre, Hz width, Hz receiver_centre, Hz receiver_width)
{
    const double low = std::max((centre - width / 2).get(), (receiver_centre - receiver_width / 2).get());
    const double high = std::min((centre + width / 2).get(), (receiver_centre + receiver_width / 2).get());
    return std::max(high - low, 0.0) / width.get();
}

bool
Reach::Has(uint32_t radio) const
{
    const auto found = std::lower_bound(receivers_dbm.begin(), receivers_dbm.end(), radio,
                                        [](const auto& each, uint32_t row) { return each.first < row; });
    return found != receivers_dbm.end() && found->first == radio;
}

double
Reach::PowerDbm(uint32_t radio) const
{
    if (radio == sender)
    {
        return power_dbm; // the other interfaces of the radio that sends share its antenna
    }
    const auto found = std::lower_bound(receivers_dbm.begin(), receivers_dbm.end(), radio,
                                        [](const auto& each, uint32_t row) { return each.first < row; });
    if (found == receivers_dbm.end() || found->first != radio)
    {
        throw cRuntimeError("a radio receives what does not reach it");
    }
    return found->second;
}

IWirelessSignal*
ListedMedium::transmitPacket(const IRadio* radio, Packet* packet)
{
    const int64_t key = KeyOf(packet);
    const Frame& frame = TheAir().frames.at(key);
    m_next = Reach{key, frame.request.radio, frame.request.channel, frame.request.waveform,
                   frame.request.power_dbm, frame.paths, {}};
    return RadioMedium::transmitPacket(radio, packet);
}

/// Powers at the receivers: given, or from INET's models. A receiver that no power reaches is left out.
void
ListedMedium::AddReceivers(Reach& reach, const ITransmission* transmission) const
{
    const Air& air = TheAir();
    for (const Path& path : reach.paths)
    {
        double gain_db = path.gain_db;
        if (air.hello.own_losses)
        {
            const std::unique_ptr<const IArrival> arrival(Arrive(reach, transmission, path.radio));
            double gain = pathLoss->computePathLoss(transmission, arrival.get());
            if (obstacleLoss != nullptr)
            {
                gain *= obstacleLoss->computeObstacleLoss(BandOf(transmission)->getCenterFrequency(),
                                                          transmission->getStartPosition(),
                                                          arrival->getStartPosition());
            }
            gain_db += Decibels(std::min(gain, 1.0)); // as INET does
        }
        if (path.radio != reach.sender && std::isfinite(gain_db))
        {
            reach.receivers_dbm.emplace_back(path.radio, reach.power_dbm + gain_db);
        }
    }
    std::sort(reach.receivers_dbm.begin(), reach.receivers_dbm.end());
}

const IArrival*
ListedMedium::Arrive(const Reach& reach, const ITransmission* transmission, uint32_t receiver) const
{
    const simtime_t delay = receiver == reach.sender ? SIMTIME_ZERO : TheAir().Delay(reach.sender, receiver);
    const Coord& place = TheAir().places[receiver];
    return new Arrival(delay, delay, transmission->getStartTime() + delay, transmission->getEndTime() + delay,
                       transmission->getPreambleDuration(), transmission->getHeaderDuration(),
                       transmission->getDataDuration(), place, place, Quaternion::IDENTITY, Quaternion::IDENTITY);
}

/// Interfaces at which a transmission arrives: those of the listed radios, and others of the sender, whose band it
/// overlaps.
std::vector<ObservedRadio*>
ListedMedium::Receivers(const Reach& reach, const ITransmission* transmission) const
{
    std::vector<ObservedRadio*> found;
    const auto band = BandOf(transmission);
    const auto add = [&](uint32_t radio) {
        for (ObservedRadio* each : TheAir().interfaces[radio])
        {
            if (each->getId() != transmission->getTransmitterId() &&
                Overlap(band->getCenterFrequency(), band->getBandwidth(), each->CentreFrequency(),
                        each->Bandwidth()) > 0.0)
            {
                found.push_back(each);
            }
        }
    };
    add(reach.sender);
    for (const auto& receiver : reach.receivers_dbm)
    {
        add(receiver.first);
    }
    return found;
}

/// Make a transmission known at one receiver (as RadioMedium::addTransmission does for all radios).
void
ListedMedium::Connect(const ITransmission* transmission, const ObservedRadio* receiver)
{
    const IArrival* arrival = Arrive(ReachOf(transmission), transmission, receiver->address.radio);
    const auto interval = new IntervalTree::Interval(arrival->getStartTime(), arrival->getEndTime(),
                                                     const_cast<ITransmission*>(transmission));
    const IListening* listening =
        receiver->getReceiver()->createListening(receiver, arrival->getStartTime(), arrival->getEndTime(),
                                                 arrival->getStartPosition(), arrival->getEndPosition());
    communicationCache->setCachedArrival(receiver, transmission, arrival);
    communicationCache->setCachedInterval(receiver, transmission, interval);
    communicationCache->setCachedListening(receiver, transmission, listening);
}

void
ListedMedium::addTransmission(const IRadio*, const ITransmission* transmission)
{
    Enter_Method("addTransmission");
    transmissionCount++;
    communicationCache->addTransmission(transmission);
    Reach& reach = m_reaches[transmission->getId()];
    reach = std::move(m_next);
    AddReceivers(reach, transmission);
    m_receivers = Receivers(reach, transmission);
    simtime_t last = transmission->getEndTime();
    for (const ObservedRadio* receiver : m_receivers)
    {
        Connect(transmission, receiver);
        last = std::max(last, getArrival(receiver, transmission)->getEndTime());
        const auto& address = receiver->address;
        if (address.channel == reach.channel && address.waveform == reach.waveform)
        {
            TheAir().frames.at(reach.key).receptions++;
        }
    }
    communicationCache->setCachedInterferenceEndTime(transmission,
                                                     last + mediumLimitCache->getMaxTransmissionDuration());
    if (!removeNonInterferingTransmissionsTimer->isScheduled())
    {
        scheduleAt(communicationCache->getCachedInterferenceEndTime(transmission),
                   removeNonInterferingTransmissionsTimer);
    }
}

void
ListedMedium::sendToAffectedRadios(IRadio* radio, const IWirelessSignal* signal)
{
    for (const ObservedRadio* receiver : m_receivers)
    {
        sendToRadio(radio, receiver, signal);
    }
}

void
ListedMedium::removeNonInterferingTransmissions()
{
    communicationCache->removeNonInterferingTransmissions(
        [this](const ITransmission* transmission) { m_reaches.erase(transmission->getId()); });
    communicationCache->mapTransmissions([this](const ITransmission* transmission) {
        const auto end = communicationCache->getCachedInterferenceEndTime(transmission);
        if (!removeNonInterferingTransmissionsTimer->isScheduled() && end > simTime())
        {
            scheduleAt(end, removeNonInterferingTransmissionsTimer);
        }
    });
}

void
ListedMedium::addRadio(const IRadio* radio)
{
    Enter_Method("addRadio");
    communicationCache->addRadio(radio);
    mediumLimitCache->addRadio(radio);
}

void
ListedMedium::PickUp(ObservedRadio* radio)
{
    Enter_Method("PickUp");
    std::vector<const ITransmission*> found;
    communicationCache->mapTransmissions([&](const ITransmission* transmission) {
        const Reach& reach = ReachOf(transmission);
        const bool own = reach.sender == radio->address.radio;
        const auto band = BandOf(transmission);
        if (transmission->getTransmitterId() != radio->getId() && transmission->getEndTime() > simTime() &&
            (own || reach.Has(radio->address.radio)) &&
            Overlap(band->getCenterFrequency(), band->getBandwidth(), radio->CentreFrequency(), radio->Bandwidth()) > 0)
        {
            found.push_back(transmission);
        }
    });
    for (const ITransmission* transmission : found)
    {
        Connect(transmission, radio);
        const IArrival* arrival = getArrival(radio, transmission);
        const simtime_t delay = std::max(arrival->getStartTime() - simTime(), SIMTIME_ZERO);
        auto signal = check_and_cast<WirelessSignal*>(createReceiverSignal(transmission));
        const simtime_t left = arrival->getEndTime() - simTime() - delay;
        sendDirect(signal, delay, left, radio->getRadioGate()->getPathStartGate());
        communicationCache->setCachedSignal(radio, transmission, signal);
    }
}

double
ListedMedium::LossDb(const Coord& from, const Coord& to, double frequency_hz) const
{
    if (!TheAir().hello.own_losses)
    {
        return NAN;
    }
    const Hz frequency(frequency_hz);
    const ScalarTransmission transmission(TheAir().probe, nullptr, 0, 0, 0, 0, 0, from, from, Quaternion::IDENTITY,
                                          Quaternion::IDENTITY, b(-1), b(-1), nullptr, -1, frequency, MHz(20),
                                          bps(NAN), NAN, W(1));
    const Arrival arrival(0, 0, 0, 0, 0, 0, 0, to, to, Quaternion::IDENTITY, Quaternion::IDENTITY);
    double gain = pathLoss->computePathLoss(&transmission, &arrival);
    if (obstacleLoss != nullptr)
    {
        gain *= obstacleLoss->computeObstacleLoss(frequency, from, to);
    }
    return -Decibels(std::min(gain, 1.0));
}

const IReception*
GivenPowerAnalogModel::computeReception(const IRadio* radio,
                                        const ITransmission* transmission,
                                        const IArrival* arrival) const
{
    const auto receiver = check_and_cast<const ObservedRadio*>(radio);
    const Reach& reach = check_and_cast<const ListedMedium*>(radio->getMedium())->ReachOf(transmission);
    const double dbm = reach.PowerDbm(receiver->address.radio);
    const auto band = BandOf(transmission);
    Hz centre = band->getCenterFrequency();
    Hz width = band->getBandwidth();
    double share = 1.0;
    if (centre != receiver->CentreFrequency() || width > receiver->Bandwidth())
    {
        // INET's scalar model knows no partial overlap: what falls into the receiver's band counts as a signal there
        share = Overlap(centre, width, receiver->CentreFrequency(), receiver->Bandwidth());
        centre = receiver->CentreFrequency();
        width = receiver->Bandwidth();
    }
    const W power = mW(std::pow(10.0, 0.1 * dbm) * share);
    return new ScalarReception(radio, transmission, arrival->getStartTime(), arrival->getEndTime(),
                               arrival->getStartPosition(), arrival->getEndPosition(), arrival->getStartOrientation(),
                               arrival->getEndOrientation(), centre, width, power);
}

} // namespace skyrange
