// SPDX-License-Identifier: MIT
#include "given_power_channel.h"

#include "key_tag.h"

#include "ns3/net-device.h"
#include "ns3/simulator.h"
#include "ns3/wifi-mpdu.h"
#include "ns3/wifi-ppdu.h"
#include "ns3/wifi-psdu.h"
#include "ns3/wifi-spectrum-signal-parameters.h"

#include <algorithm>
#include <cmath>

using namespace ns3;
using namespace medium_protocol;

namespace skyrange
{

namespace
{

// After its end a frame is under way for as long as it takes over 20 km, and one nanosecond (see WifiRadio::Arrive).
const int64_t kLastArrivalNs = 100'000;

// Noise so far below the threshold of energy detection does not make a channel busy.
const double kWeakDb = 10.0;

double
Ratio(double db)
{
    return std::pow(10.0, 0.1 * db);
}

bool
Overlap(uint16_t one, uint16_t other)
{
    return std::abs(int(one) - int(other)) < 5; // centres less than 25 MHz apart: 22 MHz wide each
}

} // namespace

NS_OBJECT_ENSURE_REGISTERED(GivenPowerChannel);

TypeId
GivenPowerChannel::GetTypeId()
{
    static TypeId id =
        TypeId("skyrange::GivenPowerChannel").SetParent<SpectrumChannel>().AddConstructor<GivenPowerChannel>();
    return id;
}

void
GivenPowerChannel::Setup(Air* air, const WifiSettings& settings, const NodeContainer& nodes)
{
    m_air = air;
    m_settings = settings;
    m_nodes = nodes;
    m_receivers.resize(nodes.GetN());
    const double threshold_dbm = settings.energy_detection_dbm.empty() ? -62.0 : std::stod(settings.energy_detection_dbm);
    m_weak_watt = 1e-3 * Ratio(threshold_dbm - kWeakDb);
}

GivenPowerChannel::Receiver&
GivenPowerChannel::ReceiverOn(uint32_t radio, uint16_t wifi_channel)
{
    auto& channels = m_receivers[radio];
    const auto found = channels.find(wifi_channel);
    if (found != channels.end())
    {
        return found->second;
    }
    Receiver receiver;
    receiver.radio =
        std::make_unique<WifiRadio>(*m_air, m_settings, this, m_nodes.Get(radio), radio, wifi_channel);
    for (const auto& phy : m_phys)
    {
        if (phy->GetDevice() == receiver.radio->Device())
        {
            receiver.phy = phy;
        }
    }
    m_phys.clear();
    if (!receiver.phy)
    {
        throw Failure("ns-3 made a device without a spectrum interface");
    }
    Receiver& made = channels.emplace(wifi_channel, std::move(receiver)).first->second;
    for (const ActiveNoise& active : m_noise)
    {
        for (const Path& path : active.paths)
        {
            if (path.radio == radio)
            {
                Disturb(made, active.noise, path);
            }
        }
    }
    return made;
}

WifiRadio&
GivenPowerChannel::RadioOn(uint32_t radio, uint16_t wifi_channel)
{
    return *ReceiverOn(radio, wifi_channel).radio;
}

void
GivenPowerChannel::StartTx(Ptr<SpectrumSignalParameters> params)
{
    const auto wifi = DynamicCast<WifiSpectrumSignalParameters>(params);
    if (!wifi || !wifi->ppdu || !wifi->ppdu->GetPsdu())
    {
        return;
    }
    const auto key = KeyOf((*wifi->ppdu->GetPsdu()->begin())->GetPacket());
    const auto found = key ? m_air->frames.find(*key) : m_air->frames.end();
    if (found == m_air->frames.end())
    {
        return;
    }
    const std::shared_ptr<Frame> frame = found->second;
    const auto& request = frame->request;
    RadioOn(request.radio, request.channel).Start(frame, params->duration);
    Simulator::Schedule(params->duration + NanoSeconds(kLastArrivalNs), &GivenPowerChannel::Forget, this, request.key);
    for (const Path& path : frame->paths)
    {
        if (path.radio == request.radio || !m_air->present[path.radio])
        {
            continue;
        }
        const double dbm = request.power_dbm + m_air->GainDb(request.radio, path);
        if (!std::isfinite(dbm))
        {
            continue;
        }
        const Time delay = m_air->Delay(request.radio, path.radio);
        const uint32_t node = m_nodes.Get(path.radio)->GetId();
        Receiver& tuned = ReceiverOn(path.radio, request.channel);
        Ptr<SpectrumSignalParameters> copy = params->Copy();
        copy->psd = Convert(params->psd, tuned.phy->GetRxSpectrumModel());
        *copy->psd *= Ratio(dbm); // the PHY sends at 0 dBm
        Simulator::ScheduleWithContext(
            node, delay, &GivenPowerChannel::ReceiveFrame, this, &tuned, frame, copy, dbm);
        for (auto& [channel, receiver] : m_receivers[path.radio])
        {
            if (channel != request.channel && Overlap(channel, request.channel))
            {
                Ptr<SpectrumValue> psd = Convert(params->psd, receiver.phy->GetRxSpectrumModel());
                *psd *= Ratio(dbm);
                Simulator::ScheduleWithContext(
                    node, delay, &GivenPowerChannel::ReceiveNoise, this, &receiver, psd, params->duration);
            }
        }
    }
}

void
GivenPowerChannel::ReceiveFrame(Receiver* receiver,
                                std::shared_ptr<Frame> frame,
                                Ptr<SpectrumSignalParameters> params,
                                double dbm)
{
    receiver->receiving_until_ns =
        std::max(receiver->receiving_until_ns, m_air->NowNs() + params->duration.GetNanoSeconds());
    std::vector<LastingNoise> weak;
    weak.swap(receiver->weak);
    for (const LastingNoise& noise : weak)
    {
        ReceiveLasting(*receiver, noise);
    }
    receiver->radio->Arrive(frame, dbm, params->duration);
    receiver->phy->StartRx(params);
}

void
GivenPowerChannel::ReceiveNoise(Receiver* receiver, Ptr<SpectrumValue> psd, Time duration)
{
    receiver->radio->Disturb(duration);
    Ptr<SpectrumSignalParameters> params = Create<SpectrumSignalParameters>();
    params->psd = psd;
    params->duration = duration;
    receiver->phy->StartRx(params);
}

void
GivenPowerChannel::StartNoise(const Noise& noise, const std::vector<Path>& paths)
{
    const int64_t now = m_air->NowNs();
    while (!m_noise.empty() && m_noise.front().noise.to_ns <= now)
    {
        m_noise.pop_front();
    }
    m_noise.push_back({noise, paths});
    for (const Path& path : paths)
    {
        for (auto& [channel, receiver] : m_receivers[path.radio])
        {
            Disturb(receiver, noise, path);
        }
    }
}

/// Let the rest of a noise arrive at a receiver.
void
GivenPowerChannel::Disturb(Receiver& receiver, const Noise& noise, const Path& path)
{
    const double watt = 1e-3 * Ratio(noise.power_dbm + m_air->GainDb(noise.radio, path));
    const Time delay = m_air->Delay(noise.radio, path.radio);
    const LastingNoise lasting{noise.to_ns + delay.GetNanoSeconds(), noise.centre_mhz, noise.width_mhz, watt};
    if (delay.IsZero())
    {
        BeginNoise(&receiver, lasting);
        return;
    }
    const uint32_t node = m_nodes.Get(path.radio)->GetId();
    Simulator::ScheduleWithContext(node, delay, &GivenPowerChannel::BeginNoise, this, &receiver, lasting);
}

void
GivenPowerChannel::BeginNoise(Receiver* receiver, LastingNoise noise)
{
    const int64_t now = m_air->NowNs();
    if (noise.watt >= m_weak_watt || receiver->receiving_until_ns > now)
    {
        ReceiveLasting(*receiver, noise);
        return;
    }
    auto& weak = receiver->weak;
    weak.erase(std::remove_if(weak.begin(), weak.end(), [now](const auto& old) { return old.to_ns <= now; }),
               weak.end());
    weak.push_back(noise);
}

/// Hand the rest of a noise to a PHY, as far as it is within its band.
void
GivenPowerChannel::ReceiveLasting(Receiver& receiver, const LastingNoise& noise)
{
    const Time rest = NanoSeconds(noise.to_ns - m_air->NowNs());
    const auto shape = ShapeOf(noise, receiver.phy->GetRxSpectrumModel());
    if (!shape || !rest.IsStrictlyPositive())
    {
        return;
    }
    Ptr<SpectrumValue> psd = Copy<SpectrumValue>(shape);
    *psd *= noise.watt;
    ReceiveNoise(&receiver, psd, rest);
}

/// The spectrum of such noise of 1 W at a receiver; null outside of its band.
Ptr<SpectrumValue>
GivenPowerChannel::ShapeOf(const LastingNoise& noise, Ptr<const SpectrumModel> model)
{
    const auto name = std::make_tuple(model->GetUid(), noise.centre_mhz, noise.width_mhz);
    const auto found = m_shapes.find(name);
    if (found != m_shapes.end())
    {
        return found->second;
    }
    const double low = (noise.centre_mhz - 0.5 * noise.width_mhz) * 1e6;
    const double high = (noise.centre_mhz + 0.5 * noise.width_mhz) * 1e6;
    Ptr<SpectrumValue> psd = Create<SpectrumValue>(model);
    bool any = false;
    auto value = psd->ValuesBegin();
    for (auto band = psd->ConstBandsBegin(); band != psd->ConstBandsEnd(); ++band, ++value)
    {
        const double shared = std::min(high, band->fh) - std::max(low, band->fl);
        if (shared > 0.0)
        {
            *value = shared / (high - low) / (band->fh - band->fl);
            any = true;
        }
    }
    return m_shapes[name] = any ? psd : Ptr<SpectrumValue>();
}

void
GivenPowerChannel::Forget(int64_t key)
{
    m_air->frames.erase(key);
}

Ptr<SpectrumValue>
GivenPowerChannel::Convert(Ptr<const SpectrumValue> psd, Ptr<const SpectrumModel> model)
{
    const auto from = psd->GetSpectrumModel();
    if (from->GetUid() == model->GetUid())
    {
        return Copy<SpectrumValue>(psd);
    }
    const auto names = std::make_pair(from->GetUid(), model->GetUid());
    auto found = m_converters.find(names);
    if (found == m_converters.end())
    {
        found = m_converters.emplace(names, SpectrumConverter(from, model)).first;
    }
    return found->second.Convert(psd);
}

void
GivenPowerChannel::AddRx(Ptr<SpectrumPhy> phy)
{
    m_phys.push_back(phy); // until the device that it belongs to has been made
}

void
GivenPowerChannel::RemoveRx(Ptr<SpectrumPhy> phy)
{
    m_phys.erase(std::remove(m_phys.begin(), m_phys.end(), phy), m_phys.end());
}

std::size_t
GivenPowerChannel::GetNDevices() const
{
    return 0; // devices are found by radio and Wi-Fi channel
}

Ptr<NetDevice>
GivenPowerChannel::GetDevice(std::size_t) const
{
    return nullptr;
}

} // namespace skyrange
