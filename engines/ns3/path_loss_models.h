// ns-3's own propagation models, over the buildings of the scenario as axis-aligned boxes.
// SPDX-License-Identifier: MIT
#ifndef SKYRANGE_NS3_PATH_LOSS_MODELS_H
#define SKYRANGE_NS3_PATH_LOSS_MODELS_H

#include "../common/medium_protocol.h"

#include "ns3/mobility-model.h"
#include "ns3/propagation-loss-model.h"

namespace skyrange
{

/// Make the model that the parameter `path_loss` names. Throws `Failure` for an unknown one.
ns3::Ptr<ns3::PropagationLossModel> MakeLossModel(const std::map<std::string, std::string>& params);

/// Make the buildings: the bounding box of each, because ns-3 has no other shape.
void MakeBuildings(const std::vector<medium_protocol::Building>& buildings);

/// Make the mobility model of a place, with what the building models need.
ns3::Ptr<ns3::MobilityModel> MakePlace(double x, double y, double z);

/// Move a place; models that depend on the building in which it is follow.
void MovePlace(ns3::Ptr<ns3::MobilityModel> mobility, double x, double y, double z);

} // namespace skyrange

#endif
