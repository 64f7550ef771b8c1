// Settings of the engine, from the parameters of the scenario.
// SPDX-License-Identifier: MIT
#ifndef SKYRANGE_OMNETPP_SETTINGS_H
#define SKYRANGE_OMNETPP_SETTINGS_H

#include <map>
#include <string>

namespace skyrange
{

struct Settings
{
    double energy_detection_dbm = -85.0; // INET 4.5: Ieee80211Radio.receiver.energyDetection
    double sensitivity_dbm = -85.0;      // INET 4.5: Ieee80211Radio.receiver.sensitivity
    double snir_threshold_db = 4.0;      // INET 4.5: Ieee80211Radio.receiver.snirThreshold
    std::string snir_mode = "min";       // INET 4.5: receiver.snirThresholdMode and receiver.errorModel.snirMode
    std::string error_model = "Ieee80211NistErrorModel";
    std::string path_loss = "FreeSpacePathLoss";
    double path_loss_exponent = 2.0; // INET 4.5: FreeSpacePathLoss.alpha
    std::string obstacle_loss;       // empty: none
    std::string material = "concrete";
};

/// Throws `Failure` for a name or a value that is not known.
Settings ParseSettings(const std::map<std::string, std::string>& params);

} // namespace skyrange

#endif
