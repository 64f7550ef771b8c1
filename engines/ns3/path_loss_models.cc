// SPDX-License-Identifier: MIT
#include "path_loss_models.h"

#include "ns3/boolean.h"
#include "ns3/building.h"
#include "ns3/buildings-channel-condition-model.h"
#include "ns3/constant-position-mobility-model.h"
#include "ns3/double.h"
#include "ns3/hybrid-buildings-propagation-loss-model.h"
#include "ns3/itu-r-1411-los-propagation-loss-model.h"
#include "ns3/itu-r-1411-nlos-over-rooftop-propagation-loss-model.h"
#include "ns3/mobility-building-info.h"
#include "ns3/node.h"
#include "ns3/string.h"
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
MakeThreeGpp()
{
    // no shadowing: ns-3 draws it for all pairs from one stream, so that one radio more would change that of all others
    auto model = CreateObject<Model>();
    model->SetAttribute("Frequency", DoubleValue(kFrequencyHz));
    model->SetAttribute("ShadowingEnabled", BooleanValue(false));
    model->SetAttribute("EnforceParameterRanges", BooleanValue(false));
    model->SetChannelConditionModel(CreateObject<BuildingsChannelConditionModel>());
    return model;
}

template <typename Model>
Ptr<PropagationLossModel>
MakeWithFrequency()
{
    auto model = CreateObject<Model>();
    model->SetAttribute("Frequency", DoubleValue(kFrequencyHz));
    return model;
}

Ptr<PropagationLossModel>
MakeHybrid()
{
    auto model = CreateObject<HybridBuildingsPropagationLossModel>();
    model->SetAttribute("Frequency", DoubleValue(kFrequencyHz));
    for (const char* sigma : {"ShadowSigmaOutdoor", "ShadowSigmaIndoor", "ShadowSigmaExtWalls"})
    {
        model->SetAttribute(sigma, DoubleValue(0.0));
    }
    model->SetAttribute("Environment", StringValue("Urban"));
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

Ptr<PropagationLossModel>
MakeLossModel(const std::map<std::string, std::string>& params)
{
    const auto found = params.find("path_loss");
    const std::string name = found == params.end() ? "three_gpp_umi" : found->second;
    if (name == "three_gpp_umi")
    {
        return MakeThreeGpp<ThreeGppUmiStreetCanyonPropagationLossModel>();
    }
    if (name == "three_gpp_uma")
    {
        return MakeThreeGpp<ThreeGppUmaPropagationLossModel>();
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
    if (name == "hybrid_buildings")
    {
        return MakeHybrid();
    }
    throw Failure("path_loss " + name +
                  ": expected three_gpp_umi, three_gpp_uma, friis, two_ray, itu_r_1411_los, "
                  "itu_r_1411_over_rooftop or hybrid_buildings");
}

void
MakeBuildings(const std::vector<medium_protocol::Building>& buildings)
{
    for (const auto& building : buildings)
    {
        if (building.corners_m.size() < 6)
        {
            continue;
        }
        Box box(building.corners_m[0], building.corners_m[0], building.corners_m[1], building.corners_m[1],
                building.base_m, building.top_m);
        for (size_t k = 0; k + 1 < building.corners_m.size(); k += 2)
        {
            box.xMin = std::min(box.xMin, building.corners_m[k]);
            box.xMax = std::max(box.xMax, building.corners_m[k]);
            box.yMin = std::min(box.yMin, building.corners_m[k + 1]);
            box.yMax = std::max(box.yMax, building.corners_m[k + 1]);
        }
        CreateObject<ns3::Building>()->SetBoundaries(box);
    }
}

Ptr<MobilityModel>
MakePlace(double x, double y, double z)
{
    auto mobility = CreateObject<ConstantPositionMobilityModel>();
    auto info = CreateObject<MobilityBuildingInfo>();
    mobility->AggregateObject(info);
    MovePlace(mobility, x, y, z);
    return mobility;
}

void
MovePlace(Ptr<MobilityModel> mobility, double x, double y, double z)
{
    mobility->SetPosition(Vector(x, y, z));
    mobility->GetObject<MobilityBuildingInfo>()->MakeConsistent(mobility);
}

} // namespace skyrange
