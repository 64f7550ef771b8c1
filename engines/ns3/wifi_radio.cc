// SPDX-License-Identifier: MIT
#include "wifi_radio.h"

#include "key_tag.h"

#include "ns3/callback.h"
#include "ns3/simulator.h"
#include "ns3/spectrum-wifi-helper.h"
#include "ns3/string.h"
#include "ns3/txop.h"
#include "ns3/wifi-helper.h"
#include "ns3/wifi-mac-header.h"
#include "ns3/wifi-mac-helper.h"
#include "ns3/wifi-mac-queue.h"
#include "ns3/wifi-mac.h"
#include "ns3/wifi-mpdu.h"
#include "ns3/wifi-phy-state-helper.h"

#include <algorithm>
#include <cmath>

using namespace ns3;
using namespace medium_protocol;

namespace skyrange
{

namespace
{

// A frame that has waited for access so long is dropped, as skyrange's medium contract says.
const int64_t kMaxWaitNs = 500'000'000;
// MAC header of a group-addressed data frame, the check sequence, and the LLC header that ns-3 expects in the body.
const uint32_t kHeaderBytes = 24;
const uint32_t kLlcBytes = 8;
const uint32_t kCheckBytes = 4;
const uint32_t kMaxBytes = 2346; // IEEE 802.11-2020 table 9-25: 2304 and headers
// By waveform, IEEE 802.11-2020 table 15-6 (DSSS) and 18.4.5 (ERP with a short slot): slot time and CWmin.
const int64_t kSlotUs[] = {20, 9};
const uint32_t kMinCw[] = {31, 15};
const char* const kMode[] = {"DsssRate1Mbps", "ErpOfdmRate6Mbps"};

Outcome
OutcomeOf(WifiPhyRxfailureReason reason, bool overlapped)
{
    switch (reason)
    {
    case TXING:
    case RECEPTION_ABORTED_BY_TX:
        return SENDING;
    case RXING:
    case BUSY_DECODING_PREAMBLE:
    case PREAMBLE_DETECTION_PACKET_SWITCH:
    case FRAME_CAPTURE_PACKET_SWITCH:
        return BUSY;
    default:
        return overlapped ? COLLIDED : WEAK;
    }
}

void
SetIfGiven(WifiPhyHelper& phy, const std::string& attribute, const std::string& value)
{
    if (!value.empty())
    {
        phy.Set(attribute, DoubleValue(std::stod(value)));
    }
}

} // namespace

WifiSettings
ParseWifiSettings(const std::map<std::string, std::string>& params)
{
    const auto text = [&](const std::string& name) {
        const auto found = params.find(name);
        return found == params.end() ? std::string() : found->second;
    };
    const std::map<std::string, std::string> models{{"", "ns3::TableBasedErrorRateModel"},
                                                    {"table", "ns3::TableBasedErrorRateModel"},
                                                    {"nist", "ns3::NistErrorRateModel"},
                                                    {"yans", "ns3::YansErrorRateModel"}};
    const auto model = models.find(text("error_model"));
    if (model == models.end())
    {
        throw Failure("error_model " + text("error_model") + ": expected table, nist or yans");
    }
    WifiSettings settings;
    settings.error_model = model->second;
    settings.preamble_detection = text("preamble_detection") != "false";
    settings.preamble_rssi_dbm = text("preamble_rssi_dbm");
    settings.preamble_snr_db = text("preamble_snr_db");
    settings.capture_margin_db = text("capture_margin_db");
    settings.sensitivity_dbm = text("sensitivity_dbm");
    settings.energy_detection_dbm = text("energy_detection_dbm");
    settings.carrier_sense_dbm = text("carrier_sense_dbm");
    return settings;
}

WifiRadio::WifiRadio(Air& air,
                     const WifiSettings& settings,
                     Ptr<SpectrumChannel> channel,
                     Ptr<Node> node,
                     uint32_t radio,
                     uint16_t wifi_channel)
    : m_air(air),
      m_radio(radio),
      m_channel(wifi_channel)
{
    SpectrumWifiPhyHelper phy;
    phy.SetChannel(channel);
    phy.Set("ChannelSettings", StringValue("{" + std::to_string(wifi_channel) + ", 20, BAND_2_4GHZ, 0}"));
    phy.Set("TxPowerStart", DoubleValue(0.0)); // the channel applies each frame's power
    phy.Set("TxPowerEnd", DoubleValue(0.0));
    phy.Set("RxNoiseFigure", DoubleValue(air.hello.radios[radio].noise_figure_db));
    SetIfGiven(phy, "RxSensitivity", settings.sensitivity_dbm);
    SetIfGiven(phy, "CcaEdThreshold", settings.energy_detection_dbm);
    SetIfGiven(phy, "CcaSensitivity", settings.carrier_sense_dbm);
    phy.SetErrorRateModel(settings.error_model);
    if (settings.preamble_detection)
    {
        const std::string rssi = settings.preamble_rssi_dbm.empty() ? "-82" : settings.preamble_rssi_dbm;
        const std::string snr = settings.preamble_snr_db.empty() ? "4" : settings.preamble_snr_db;
        phy.SetPreambleDetectionModel("ns3::ThresholdPreambleDetectionModel",
                                      "MinimumRssi", DoubleValue(std::stod(rssi)),
                                      "Threshold", DoubleValue(std::stod(snr)));
    }
    else
    {
        phy.DisablePreambleDetectionModel();
    }
    if (!settings.capture_margin_db.empty())
    {
        phy.SetFrameCaptureModel("ns3::SimpleFrameCaptureModel",
                                 "Margin", DoubleValue(std::stod(settings.capture_margin_db)));
    }
    WifiHelper wifi;
    wifi.SetStandard(WIFI_STANDARD_80211g);
    wifi.SetRemoteStationManager("ns3::ConstantRateWifiManager",
                                 "DataMode", StringValue(kMode[OFDM_6M]),
                                 "ControlMode", StringValue(kMode[OFDM_6M]),
                                 "NonUnicastMode", StringValue(kMode[OFDM_6M]));
    WifiMacHelper mac;
    mac.SetType("ns3::AdhocWifiMac", "QosSupported", BooleanValue(false));
    const NetDeviceContainer devices = wifi.Install(phy, mac, node);
    m_device = DynamicCast<WifiNetDevice>(devices.Get(0));
    m_device->Initialize(); // ns-3 would do so in an event of its own, and the device is needed now
    // 2^14 streams for each radio and channel; the address depends on the radio's name, never on its row
    const uint64_t address = air.hello.radios[radio].stream ^ (0x9e3779b97f4a7c15ULL * wifi_channel);
    wifi.AssignStreams(devices, int64_t((address << 15 >> 1) | (1ULL << 62)));
    m_device->GetMac()->GetTxop()->SetMinCw(kMinCw[OFDM_6M]);
    m_device->GetPhy()->SetSlot(MicroSeconds(kSlotUs[OFDM_6M]));
    m_device->GetPhy()->TraceConnectWithoutContext("MonitorSnifferRx", MakeCallback(&WifiRadio::OnDecoded, this));
    m_device->GetPhy()->TraceConnectWithoutContext("PhyRxDrop", MakeCallback(&WifiRadio::OnDropped, this));
    m_device->GetPhy()->GetState()->TraceConnectWithoutContext("RxError", MakeCallback(&WifiRadio::OnError, this));
}

void
WifiRadio::Offer(const std::shared_ptr<Frame>& frame)
{
    const auto& request = frame->request;
    if (request.size_bytes < kHeaderBytes + kLlcBytes + kCheckBytes || request.size_bytes > kMaxBytes)
    {
        const int64_t now = m_air.NowNs();
        m_air.sent.push_back({request.key, now, now, m_radio, m_channel, REFUSED});
        m_air.frames.erase(request.key);
        return;
    }
    if (!m_air.present[m_radio])
    {
        GiveUp(frame);
        return;
    }
    m_waiting.push_back(frame);
    Simulator::Schedule(NanoSeconds(kMaxWaitNs), &WifiRadio::Expire, this, request.key);
    HandOver();
}

/// Give the first waiting frame to the MAC, if it has none. One at a time, because slot and mode depend on the frame;
/// the backoff after a transmission is counted down all the same.
void
WifiRadio::HandOver()
{
    if (m_waiting.empty() || m_waiting.front()->handed_over)
    {
        return;
    }
    Frame& frame = *m_waiting.front();
    frame.handed_over = true;
    const uint16_t waveform = frame.request.waveform;
    m_device->GetRemoteStationManager()->SetAttribute("NonUnicastMode", StringValue(kMode[waveform]));
    m_device->GetPhy()->SetSlot(MicroSeconds(kSlotUs[waveform]));
    m_device->GetMac()->GetTxop()->SetMinCw(kMinCw[waveform]);
    Ptr<Packet> packet = Create<Packet>(frame.request.size_bytes - kHeaderBytes - kCheckBytes);
    KeyTag tag;
    tag.key = frame.request.key;
    packet->AddPacketTag(tag);
    WifiMacHeader header;
    header.SetType(WIFI_MAC_DATA);
    header.SetAddr1(Mac48Address::GetBroadcast());
    header.SetAddr2(m_device->GetMac()->GetAddress());
    header.SetAddr3(m_device->GetMac()->GetAddress());
    header.SetDsNotFrom();
    header.SetDsNotTo();
    m_device->GetMac()->GetTxop()->Queue(Create<WifiMpdu>(packet, header));
}

void
WifiRadio::Expire(int64_t key)
{
    const auto found = std::find_if(m_waiting.begin(), m_waiting.end(), [key](const auto& frame) {
        return frame->request.key == key;
    });
    if (found == m_waiting.end() || (*found)->started)
    {
        return;
    }
    const std::shared_ptr<Frame> frame = *found;
    m_waiting.erase(found);
    if (frame->handed_over)
    {
        Ptr<WifiMacQueue> queue = m_device->GetMac()->GetTxop()->GetWifiMacQueue();
        while (queue->GetNPackets() > 0 && queue->Remove())
        {
        }
    }
    GiveUp(frame);
    HandOver();
}

void
WifiRadio::GiveUp(const std::shared_ptr<Frame>& frame)
{
    const int64_t now = m_air.NowNs();
    m_air.sent.push_back({frame->request.key, now, now, m_radio, m_channel, NO_ACCESS});
    m_air.frames.erase(frame->request.key);
}

void
WifiRadio::Start(const std::shared_ptr<Frame>& frame, Time duration)
{
    frame->started = true;
    m_sending_from_ns = m_air.NowNs();
    m_sending_until_ns = m_sending_from_ns + duration.GetNanoSeconds();
    Simulator::Schedule(duration, &WifiRadio::EndTransmission, this, frame->request.key, m_sending_from_ns);
}

void
WifiRadio::EndTransmission(int64_t key, int64_t start_ns)
{
    m_air.sent.push_back({key, start_ns, m_air.NowNs(), m_radio, m_channel, SENT});
    if (!m_waiting.empty() && m_waiting.front()->request.key == key)
    {
        m_waiting.pop_front();
    }
    HandOver();
}

void
WifiRadio::Arrive(const std::shared_ptr<Frame>& frame, double dbm, Time duration)
{
    const int64_t now = m_air.NowNs();
    const int64_t end = now + duration.GetNanoSeconds();
    m_arrivals.push_back({frame, now, end, dbm, -INFINITY, WEAK, false});
    // one nanosecond later than ns-3 ends the reception, in which it says whether the frame was decoded
    Simulator::Schedule(duration + NanoSeconds(1), &WifiRadio::EndArrival, this, frame->request.key);
}

void
WifiRadio::Disturb(Time duration)
{
    const int64_t now = m_air.NowNs();
    m_disturbances.emplace_back(now, now + duration.GetNanoSeconds());
}

/// Tell what became of a frame that was not decoded, and forget it and the disturbances that are over.
void
WifiRadio::EndArrival(int64_t key)
{
    const auto found = std::find_if(m_arrivals.begin(), m_arrivals.end(), [key](const Arrival& arrival) {
        return arrival.frame->request.key == key;
    });
    if (found != m_arrivals.end() && !found->told)
    {
        if (found->outcome == WEAK && Overlapped(*found))
        {
            found->outcome = COLLIDED;
        }
        Tell(*found);
    }
    // arrivals stay for as long as a later one may ask whether it overlapped them
    const int64_t now = m_air.NowNs();
    const int64_t kept_ns = 50'000'000;
    while (!m_arrivals.empty() && m_arrivals.front().told && m_arrivals.front().end_ns < now - kept_ns)
    {
        m_arrivals.pop_front();
    }
    while (!m_disturbances.empty() && m_disturbances.front().second < now - kept_ns)
    {
        m_disturbances.pop_front();
    }
}

void
WifiRadio::OnDecoded(Ptr<const Packet> packet, uint16_t, WifiTxVector, MpduInfo, SignalNoiseDbm signal, uint16_t)
{
    if (Arrival* arrival = Find(packet))
    {
        arrival->outcome = DECODED;
        arrival->dbm = signal.signal;
        arrival->snir_db = signal.signal - signal.noise;
        Tell(*arrival);
    }
}

void
WifiRadio::OnDropped(Ptr<const Packet> packet, WifiPhyRxfailureReason reason)
{
    if (Arrival* arrival = Find(packet))
    {
        arrival->outcome = OutcomeOf(reason, Overlapped(*arrival));
    }
}

void
WifiRadio::OnError(Ptr<const Packet> packet, double snr)
{
    if (Arrival* arrival = Find(packet))
    {
        arrival->outcome = Overlapped(*arrival) ? COLLIDED : WEAK;
        arrival->snir_db = 10.0 * std::log10(snr);
    }
}

WifiRadio::Arrival*
WifiRadio::Find(Ptr<const Packet> packet)
{
    const auto key = KeyOf(packet);
    const auto found = std::find_if(m_arrivals.rbegin(), m_arrivals.rend(), [&key](const Arrival& arrival) {
        return key && arrival.frame->request.key == *key && !arrival.told;
    });
    return found == m_arrivals.rend() ? nullptr : &*found;
}

bool
WifiRadio::Overlapped(const Arrival& arrival) const
{
    for (const auto& other : m_arrivals)
    {
        if (&other != &arrival && other.start_ns < arrival.end_ns && other.end_ns > arrival.start_ns)
        {
            return true;
        }
    }
    for (const auto& [start_ns, end_ns] : m_disturbances)
    {
        if (start_ns < arrival.end_ns && end_ns > arrival.start_ns)
        {
            return true;
        }
    }
    return false;
}

void
WifiRadio::Tell(Arrival& arrival)
{
    arrival.told = true;
    const double snir_db = std::isfinite(arrival.snir_db) ? arrival.snir_db : 0.0;
    m_air.heard.push_back({arrival.frame->request.key,
                           m_air.NowNs(),
                           arrival.dbm,
                           snir_db,
                           m_radio,
                           m_channel,
                           uint16_t(arrival.outcome)});
}

} // namespace skyrange
