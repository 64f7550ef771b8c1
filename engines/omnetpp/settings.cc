// SPDX-License-Identifier: MIT
#include "settings.h"

#include "../common/medium_protocol.h"

#include <cmath>

using medium_protocol::Failure;

namespace skyrange
{

namespace
{

double
ParseNumber(const std::string& name, const std::string& text)
{
    size_t used = 0;
    double value = NAN;
    try
    {
        value = std::stod(text, &used);
    }
    catch (const std::exception&)
    {
        used = 0;
    }
    if (used == 0 || used != text.size() || !std::isfinite(value))
    {
        throw Failure(name + " " + text + ": expected a number");
    }
    return value;
}

std::string
ParseChoice(const std::string& name, const std::string& text, const std::map<std::string, std::string>& choices)
{
    const auto found = choices.find(text);
    if (found != choices.end())
    {
        return found->second;
    }
    std::string expected;
    for (const auto& choice : choices)
    {
        expected += (expected.empty() ? "" : ", ") + choice.first;
    }
    throw Failure(name + " " + text + ": expected one of " + expected);
}

} // namespace

Settings
ParseSettings(const std::map<std::string, std::string>& params)
{
    Settings settings;
    for (const auto& [name, text] : params)
    {
        if (name == "energy_detection_dbm")
        {
            settings.energy_detection_dbm = ParseNumber(name, text);
        }
        else if (name == "sensitivity_dbm")
        {
            settings.sensitivity_dbm = ParseNumber(name, text);
        }
        else if (name == "snir_threshold_db")
        {
            settings.snir_threshold_db = ParseNumber(name, text);
        }
        else if (name == "snir_mode")
        {
            settings.snir_mode = ParseChoice(name, text, {{"min", "min"}, {"mean", "mean"}});
        }
        else if (name == "path_loss_exponent")
        {
            settings.path_loss_exponent = ParseNumber(name, text);
        }
        else if (name == "error_model")
        {
            settings.error_model =
                ParseChoice(name, text, {{"nist", "Ieee80211NistErrorModel"}, {"yans", "Ieee80211YansErrorModel"}});
        }
        else if (name == "path_loss")
        {
            settings.path_loss = ParseChoice(name, text,
                                             {{"free_space", "FreeSpacePathLoss"},
                                              {"two_ray", "TwoRayGroundReflection"},
                                              {"two_ray_interference", "TwoRayInterference"}});
        }
        else if (name == "obstacle_loss")
        {
            settings.obstacle_loss = ParseChoice(
                name, text, {{"none", ""}, {"ideal", "IdealObstacleLoss"}, {"dielectric", "DielectricObstacleLoss"}});
        }
        else if (name == "material")
        {
            settings.material = ParseChoice(
                name, text, {{"concrete", "concrete"}, {"brick", "brick"}, {"glass", "glass"}, {"wood", "wood"}});
        }
        else
        {
            throw Failure("the unknown parameter " + name);
        }
    }
    return settings;
}

} // namespace skyrange
