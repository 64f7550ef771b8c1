// A radio on one Wi-Fi channel: an ns-3 device, the frames that wait for it, and the receptions under way at it.
// SPDX-License-Identifier: MIT
#ifndef SKYRANGE_NS3_WIFI_RADIO_H
#define SKYRANGE_NS3_WIFI_RADIO_H

#include "air.h"

#include "ns3/node.h"
#include "ns3/spectrum-channel.h"
#include "ns3/spectrum-phy.h"
#include "ns3/wifi-net-device.h"
#include "ns3/wifi-phy-common.h"
#include "ns3/wifi-phy.h"

#include <deque>

namespace skyrange
{

/// Settings of all devices, from the parameters of the scenario. An empty text leaves ns-3's own default.
struct WifiSettings
{
    std::string error_model;
    bool preamble_detection = true;
    std::string preamble_rssi_dbm;
    std::string preamble_snr_db;
    std::string capture_margin_db; // empty: no frame capture model, as in ns-3
    std::string sensitivity_dbm;
    std::string energy_detection_dbm;
    std::string carrier_sense_dbm;
};

WifiSettings ParseWifiSettings(const std::map<std::string, std::string>& params);

class WifiRadio
{
  public:
    WifiRadio(Air& air,
              const WifiSettings& settings,
              ns3::Ptr<ns3::SpectrumChannel> channel,
              ns3::Ptr<ns3::Node> node,
              uint32_t radio,
              uint16_t wifi_channel);
    WifiRadio(const WifiRadio&) = delete;
    WifiRadio& operator=(const WifiRadio&) = delete;

    /// Take a frame to be sent now, or after those that wait.
    void Offer(const std::shared_ptr<Frame>& frame);

    /// A frame of this radio goes on the air for `duration`.
    void Start(const std::shared_ptr<Frame>& frame, ns3::Time duration);

    /// A frame arrives at the antenna at `dbm`; returns false if it need not be received, because it is known already.
    void Arrive(const std::shared_ptr<Frame>& frame, double dbm, ns3::Time duration);

    /// Noise or a frame of another channel arrives.
    void Disturb(ns3::Time duration);

    uint32_t Radio() const
    {
        return m_radio;
    }

    uint16_t Channel() const
    {
        return m_channel;
    }

    ns3::Ptr<ns3::WifiNetDevice> Device() const
    {
        return m_device;
    }

  private:
    struct Arrival
    {
        std::shared_ptr<Frame> frame;
        int64_t start_ns;
        int64_t end_ns;
        double dbm;
        double snir_db;
        medium_protocol::Outcome outcome;
        bool told;
    };

    void HandOver();
    void Expire(int64_t key);
    void GiveUp(const std::shared_ptr<Frame>& frame);
    void EndTransmission(int64_t key, int64_t start_ns);
    void EndArrival(int64_t key);
    void OnDecoded(ns3::Ptr<const ns3::Packet> packet,
                   uint16_t frequency,
                   ns3::WifiTxVector vector,
                   ns3::MpduInfo mpdu,
                   ns3::SignalNoiseDbm signal,
                   uint16_t station);
    void OnDropped(ns3::Ptr<const ns3::Packet> packet, ns3::WifiPhyRxfailureReason reason);
    void OnError(ns3::Ptr<const ns3::Packet> packet, double snr);
    Arrival* Find(ns3::Ptr<const ns3::Packet> packet);
    bool Overlapped(const Arrival& arrival) const;
    void Tell(Arrival& arrival);

    Air& m_air;
    uint32_t m_radio;
    uint16_t m_channel;
    ns3::Ptr<ns3::WifiNetDevice> m_device;
    std::deque<std::shared_ptr<Frame>> m_waiting; // the first one is with the MAC if `handed_over`
    std::deque<Arrival> m_arrivals;
    std::deque<std::pair<int64_t, int64_t>> m_disturbances; // start, end
    int64_t m_sending_from_ns = INT64_MIN;
    int64_t m_sending_until_ns = INT64_MIN;
};

} // namespace skyrange

#endif
