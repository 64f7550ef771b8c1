// A spectrum channel in which a frame reaches the radios that it lists, each with the power that belongs to it.
// SPDX-License-Identifier: MIT
#ifndef SKYRANGE_NS3_GIVEN_POWER_CHANNEL_H
#define SKYRANGE_NS3_GIVEN_POWER_CHANNEL_H

#include "air.h"
#include "wifi_radio.h"

#include "ns3/node-container.h"
#include "ns3/spectrum-channel.h"
#include "ns3/spectrum-converter.h"
#include "ns3/spectrum-signal-parameters.h"
#include "ns3/spectrum-value.h"

#include <deque>
#include <map>
#include <memory>
#include <tuple>
#include <vector>

namespace skyrange
{

class GivenPowerChannel : public ns3::SpectrumChannel
{
  public:
    static ns3::TypeId GetTypeId();

    /// Connect the channel with the frames and the nodes (one per radio); before anything else.
    void Setup(Air* air, const WifiSettings& settings, const ns3::NodeContainer& nodes);

    /// The radio on a Wi-Fi channel; it is made when it is first needed.
    WifiRadio& RadioOn(uint32_t radio, uint16_t wifi_channel);

    /// Let noise arrive at the receivers of its paths from now on. Noise too weak for carrier sense is handed to a PHY
    /// only while it receives: the traffic of a city is some hundred pieces a second at each radio.
    void StartNoise(const medium_protocol::Noise& noise, const std::vector<medium_protocol::Path>& paths);

    void StartTx(ns3::Ptr<ns3::SpectrumSignalParameters> params) override;
    void AddRx(ns3::Ptr<ns3::SpectrumPhy> phy) override;
    void RemoveRx(ns3::Ptr<ns3::SpectrumPhy> phy) override;
    std::size_t GetNDevices() const override;
    ns3::Ptr<ns3::NetDevice> GetDevice(std::size_t index) const override;

  private:
    /// Noise that lasts, of a receiver.
    struct LastingNoise
    {
        int64_t to_ns;
        double centre_mhz;
        double width_mhz;
        double watt;
    };

    struct Receiver
    {
        std::unique_ptr<WifiRadio> radio;
        ns3::Ptr<ns3::SpectrumPhy> phy;
        std::vector<LastingNoise> weak; // not handed to the PHY yet
        int64_t receiving_until_ns = INT64_MIN;
    };

    struct ActiveNoise
    {
        medium_protocol::Noise noise;
        std::vector<medium_protocol::Path> paths;
    };

    Receiver& ReceiverOn(uint32_t radio, uint16_t wifi_channel);
    void ReceiveFrame(Receiver* receiver,
                      std::shared_ptr<Frame> frame,
                      ns3::Ptr<ns3::SpectrumSignalParameters> params,
                      double dbm);
    void ReceiveNoise(Receiver* receiver, ns3::Ptr<ns3::SpectrumValue> psd, ns3::Time duration);
    void Disturb(Receiver& receiver, const medium_protocol::Noise& noise, const medium_protocol::Path& path);
    void BeginNoise(Receiver* receiver, LastingNoise noise);
    void ReceiveLasting(Receiver& receiver, const LastingNoise& noise);
    ns3::Ptr<ns3::SpectrumValue> ShapeOf(const LastingNoise& noise, ns3::Ptr<const ns3::SpectrumModel> model);
    void Forget(int64_t key);
    ns3::Ptr<ns3::SpectrumValue> Convert(ns3::Ptr<const ns3::SpectrumValue> psd,
                                         ns3::Ptr<const ns3::SpectrumModel> model);

    Air* m_air = nullptr;
    WifiSettings m_settings;
    ns3::NodeContainer m_nodes;
    std::vector<std::map<uint16_t, Receiver>> m_receivers; // by radio, then by Wi-Fi channel
    std::vector<ns3::Ptr<ns3::SpectrumPhy>> m_phys; // of the device that is being made
    std::deque<ActiveNoise> m_noise;                // for devices that are made while it lasts
    std::map<std::pair<uint32_t, uint32_t>, ns3::SpectrumConverter> m_converters;
    std::map<std::tuple<uint32_t, double, double>, ns3::Ptr<ns3::SpectrumValue>> m_shapes; // of noise of 1 W
    double m_weak_watt = 0.0;
};

} // namespace skyrange

#endif
