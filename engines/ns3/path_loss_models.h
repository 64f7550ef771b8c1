// ns-3's own propagation models, with the lines of sight of the scenario's buildings.
// SPDX-License-Identifier: MIT
#ifndef SKYRANGE_NS3_PATH_LOSS_MODELS_H
#define SKYRANGE_NS3_PATH_LOSS_MODELS_H

#include "../common/medium_protocol.h"

#include "ns3/channel-condition-model.h"
#include "ns3/mobility-model.h"
#include "ns3/propagation-loss-model.h"

namespace skyrange
{

/// Whether there is a line of sight, by prisms with any outline. ns-3's own buildings are boxes along the axes, and may
/// not overlap. All radios are outside of buildings.
class PrismConditionModel : public ns3::ChannelConditionModel
{
  public:
    static ns3::TypeId GetTypeId();

    void SetBuildings(const std::vector<medium_protocol::Building>& buildings);
    bool IsBlocked(const ns3::Vector& from, const ns3::Vector& to) const;

    ns3::Ptr<ns3::ChannelCondition> GetChannelCondition(ns3::Ptr<const ns3::MobilityModel> from,
                                                        ns3::Ptr<const ns3::MobilityModel> to) const override;
    int64_t AssignStreams(int64_t stream) override;

  private:
    struct Prism
    {
        medium_protocol::Building building;
        double west;
        double south;
        double east;
        double north;
    };

    std::vector<Prism> m_prisms;
};

/// Make the model that the parameter `path_loss` names. Throws `Failure` for an unknown one.
ns3::Ptr<ns3::PropagationLossModel> MakeLossModel(const medium_protocol::Hello& hello);

} // namespace skyrange

#endif
