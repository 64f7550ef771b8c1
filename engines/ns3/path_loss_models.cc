// SPDX-License-Identifier: MIT
#include "path_loss_models.h"

#include "ns3/boolean.h"
#include "ns3/double.h"
#include "ns3/itu-r-1411-los-propagation-loss-model.h"
#include "ns3/itu-r-1411-nlos-over-rooftop-propagation-loss-model.h"
#include "ns3/three-gpp-propagation-loss-model.h"

#include <algorithm>

using namespace ns3;
using namespace medium_protocol;

namespace skyrange
{

namespace
{

const double kFrequencyHz = 2.437e9; // channel 6

template <typename Model>
Ptr<PropagationLossModel>
MakeWithFrequency()
{
    auto model = CreateObject<Model>();
    model->SetAttribute("Frequency", DoubleValue(kFrequencyHz));
    return model;
}

Ptr<PropagationLossModel>
MakeThreeGppUmi(const Hello& hello)
{
    auto sight = CreateObject<PrismConditionModel>();
    sight->SetBuildings(hello.buildings);
    auto model = CreateObject<ThreeGppUmiStreetCanyonPropagationLossModel>();
    model->SetAttribute("Frequency", DoubleValue(kFrequencyHz));
    // no shadowing: ns-3 draws it for all pairs from one stream, so that one radio more would change that of all others
    model->SetAttribute("ShadowingEnabled", BooleanValue(false));
    model->SetAttribute("EnforceParameterRanges", BooleanValue(false));
    model->SetChannelConditionModel(sight);
    return model;
}

Ptr<PropagationLossModel>
MakeLos1411()
{
    auto model = CreateObject<ItuR1411LosPropagationLossModel>();
    model->SetFrequency(kFrequencyHz);
    return model;
}

} // namespace

NS_OBJECT_ENSURE_REGISTERED(PrismConditionModel);

TypeId
PrismConditionModel::GetTypeId()
{
    static TypeId id = TypeId("skyrange::PrismConditionModel")
                           .SetParent<ChannelConditionModel>()
                           .AddConstructor<PrismConditionModel>();
    return id;
}

void
PrismConditionModel::SetBuildings(const std::vector<Building>& buildings)
{
    for (const Building& building : buildings)
    {
        if (building.corners_m.size() < 6)
        {
            continue;
        }
        Prism prism{building, building.corners_m[0], building.corners_m[1], building.corners_m[0], building.corners_m[1]};
        for (size_t k = 0; k + 1 < building.corners_m.size(); k += 2)
        {
            prism.west = std::min(prism.west, building.corners_m[k]);
            prism.east = std::max(prism.east, building.corners_m[k]);
            prism.south = std::min(prism.south, building.corners_m[k + 1]);
            prism.north = std::max(prism.north, building.corners_m[k + 1]);
        }
        m_prisms.push_back(prism);
    }
}

/// A line meets a prism if it is within its height somewhere between the first and the last wall that it crosses.
bool
PrismConditionModel::IsBlocked(const Vector& from, const Vector& to) const
{
    const double dx = to.x - from.x;
    const double dy = to.y - from.y;
    for (const Prism& prism : m_prisms)
    {
        if (std::max(from.x, to.x) < prism.west || std::min(from.x, to.x) > prism.east ||
            std::max(from.y, to.y) < prism.south || std::min(from.y, to.y) > prism.north ||
            std::min(from.z, to.z) > prism.building.top_m || std::max(from.z, to.z) < prism.building.base_m)
        {
            continue;
        }
        const auto& corners = prism.building.corners_m;
        double first = 2.0;
        double last = -1.0;
        for (size_t k = 0; k + 1 < corners.size(); k += 2)
        {
            const size_t next = (k + 2) % corners.size();
            const double px = corners[k] - from.x;
            const double py = corners[k + 1] - from.y;
            const double qx = corners[next] - from.x;
            const double qy = corners[next + 1] - from.y;
            const double one = dx * py - dy * px;
            const double other = dx * qy - dy * qx;
            if ((one > 0.0) != (other > 0.0)) // the ends of the wall are on both sides of the line
            {
                const double along = (px * qy - py * qx) / (other - one);
                if (along >= 0.0 && along <= 1.0)
                {
                    first = std::min(first, along);
                    last = std::max(last, along);
                }
            }
        }
        if (last < 0.0)
        {
            continue;
        }
        const double enters = from.z + first * (to.z - from.z);
        const double leaves = from.z + last * (to.z - from.z);
        if (std::min(enters, leaves) < prism.building.top_m && std::max(enters, leaves) > prism.building.base_m)
        {
            return true;
        }
    }
    return false;
}

Ptr<ChannelCondition>
PrismConditionModel::GetChannelCondition(Ptr<const MobilityModel> from, Ptr<const MobilityModel> to) const
{
    auto condition = CreateObject<ChannelCondition>();
    condition->SetLosCondition(IsBlocked(from->GetPosition(), to->GetPosition()) ? ChannelCondition::NLOS
                                                                                 : ChannelCondition::LOS);
    condition->SetO2iCondition(ChannelCondition::O2O);
    return condition;
}

int64_t
PrismConditionModel::AssignStreams(int64_t)
{
    return 0;
}

Ptr<PropagationLossModel>
MakeLossModel(const Hello& hello)
{
    const auto found = hello.params.find("path_loss");
    const std::string name = found == hello.params.end() ? "three_gpp_umi" : found->second;
    if (name == "three_gpp_umi")
    {
        return MakeThreeGppUmi(hello);
    }
    if (name == "friis")
    {
        return MakeWithFrequency<FriisPropagationLossModel>();
    }
    if (name == "two_ray")
    {
        return MakeWithFrequency<TwoRayGroundPropagationLossModel>();
    }
    if (name == "itu_r_1411_los")
    {
        return MakeLos1411();
    }
    if (name == "itu_r_1411_over_rooftop")
    {
        return MakeWithFrequency<ItuR1411NlosOverRooftopPropagationLossModel>();
    }
    throw Failure("path_loss " + name +
                  ": expected three_gpp_umi, friis, two_ray, itu_r_1411_los or itu_r_1411_over_rooftop");
}

} // namespace skyrange
