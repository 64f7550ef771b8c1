// SPDX-License-Identifier: MIT
#include "controller.h"

#include "mac.h"
#include "medium.h"
#include "radio.h"

#include <cmath>

using namespace inet;
using namespace omnetpp;
using namespace medium_protocol;

namespace skyrange
{

namespace
{

const uint32_t kMinBytes = 28;   // header of a management frame and check sequence
const uint32_t kMaxBytes = 2346; // IEEE 802.11-2020 table 9-25: 2304 and headers
const uint16_t kChannels = 13;

// By waveform. Widths: what INET's modes occupy.
const char* const kOpMode[] = {"b", "g(erp)"};
const double kBitsPerS[] = {1e6, 6e6};
const double kWidthHz[] = {22e6, 20e6};

// Events of requests come before others of their time, and noise before frames, however time is cut.
const short kNoisePriority = -2;
const short kOfferPriority = -1;

bool
Exists(const Transmission& request)
{
    return request.waveform <= OFDM_6M && request.channel >= 1 && request.channel <= kChannels &&
           request.size_bytes >= kMinBytes && request.size_bytes <= kMaxBytes && std::isfinite(request.power_dbm);
}

} // namespace

Define_Module(Controller);

struct Controller::NoiseBegins : public cMessage
{
    Noise row;
    std::vector<Path> paths;
};

cModule*
Controller::Make(const char* type, const char* name)
{
    return cModuleType::get(type)->create(name, getSystemModule());
}

void
Controller::Start(cModule* module)
{
    module->scheduleStart(simTime());
    module->callInitialize();
}

void
Controller::Begin(Hello hello)
{
    Enter_Method("Begin");
    Air& air = TheAir();
    air.settings = ParseSettings(hello.params);
    air.hello = std::move(hello);
    air.places.assign(air.hello.radios.size(), Coord::ZERO);
    air.present.assign(air.hello.radios.size(), false);
    air.interfaces.resize(air.hello.radios.size());

    cModule* city = Make("skyrange.City", "physicalEnvironment");
    city->finalizeParameters();
    city->buildInside();
    Start(city);

    cModule* medium = Make("skyrange.ListedMedium", "radioMedium");
    medium->par("pathLossType").setStringValue(air.settings.path_loss);
    medium->par("obstacleLossType").setStringValue(air.settings.obstacle_loss);
    medium->par("pathLossExponent").setDoubleValue(air.settings.path_loss_exponent);
    medium->finalizeParameters();
    medium->buildInside();
    Start(medium);
    air.medium = check_and_cast<ListedMedium*>(medium);

    cModule* emitter = Make("skyrange.NoiseEmitter", "noise");
    emitter->finalizeParameters();
    emitter->buildInside();
    Start(emitter);
    air.emitter = check_and_cast<NoiseEmitter*>(emitter);
}

void
Controller::Take(const Advance& advance)
{
    Enter_Method("Take");
    Air& air = TheAir();
    for (size_t k = 0; k < advance.places.size(); k++)
    {
        const Place& place = advance.places[k];
        air.present[k] = std::isfinite(place.x) && std::isfinite(place.y) && std::isfinite(place.z);
        if (air.present[k])
        {
            air.places[k] = Coord(place.x, place.y, place.z);
        }
    }
    for (const Noise& row : advance.noise)
    {
        auto message = new NoiseBegins;
        message->row = row;
        message->paths.assign(advance.paths.begin() + row.first_path,
                              advance.paths.begin() + row.first_path + row.paths);
        message->setSchedulingPriority(kNoisePriority);
        scheduleAt(air.ToSimTime(row.from_ns), message);
    }
    for (const Transmission& request : advance.transmissions)
    {
        const auto first = advance.paths.begin() + request.first_path;
        Frame frame;
        frame.request = request;
        frame.paths.assign(first, first + request.paths);
        if (!air.frames.emplace(request.key, std::move(frame)).second)
        {
            throw Failure("the key " + std::to_string(request.key) + " names another frame that is under way");
        }
        auto message = new cMessage(std::to_string(request.key).c_str());
        message->setSchedulingPriority(kOfferPriority);
        scheduleAt(air.ToSimTime(request.at_ns), message);
    }
}

void
Controller::handleMessage(cMessage* message)
{
    if (auto noise = dynamic_cast<NoiseBegins*>(message))
    {
        TheAir().emitter->Emit(noise->row, noise->paths);
    }
    else
    {
        Offer(KeyOf(message));
    }
    delete message;
}

void
Controller::Offer(int64_t key)
{
    Air& air = TheAir();
    const Frame& frame = air.frames.at(key);
    const Transmission& request = frame.request;
    const bool exists = Exists(request);
    if (!exists || !air.present[request.radio])
    {
        air.TellSent(key, request.at_ns, request.at_ns, exists ? NO_ACCESS : REFUSED);
        return;
    }
    // also those of the receivers, because a frame on the air must not change the network
    ObservedRadio* sender = Interface(request.radio, request.channel, request.waveform);
    for (const Path& path : frame.paths)
    {
        Interface(path.radio, request.channel, request.waveform);
    }
    sender->queue->Offer(key, sender->source);
}

/// The interface of a radio on a channel; it is made when it is first needed.
ObservedRadio*
Controller::Interface(uint32_t radio, uint16_t channel, uint16_t waveform)
{
    Air& air = TheAir();
    for (ObservedRadio* each : air.interfaces[radio])
    {
        if (each->address.channel == channel && each->address.waveform == waveform)
        {
            return each;
        }
    }
    const std::string name =
        "radio" + std::to_string(radio) + "_" + std::to_string(channel) + "_" + std::to_string(waveform);
    cModule* made = Make("skyrange.RadioInterface", name.c_str());
    made->par("channelNumber").setIntValue(channel - 1);
    made->par("opMode").setStringValue(kOpMode[waveform]);
    made->par("bitrate").setDoubleValue(kBitsPerS[waveform]);
    made->par("bandwidth").setDoubleValue(kWidthHz[waveform]);
    made->par("energyDetection").setDoubleValue(air.settings.energy_detection_dbm);
    made->par("sensitivity").setDoubleValue(air.settings.sensitivity_dbm);
    made->par("snirThreshold").setDoubleValue(air.settings.snir_threshold_db);
    made->par("errorModel").setStringValue(air.settings.error_model);
    made->finalizeParameters();
    made->buildInside();
    const uint64_t stream = air.hello.radios[radio].stream;
    check_and_cast<PlacedMobility*>(made->getSubmodule("mobility"))->Place(radio);
    check_and_cast<AddressedContention*>(made->getModuleByPath(".wlan.mac.dcf.channelAccess.contention"))
        ->Address(stream, channel, waveform);
    auto found = check_and_cast<ObservedRadio*>(made->getModuleByPath(".wlan.radio"));
    found->address = {radio, channel, waveform, stream};
    found->source = check_and_cast<FrameSource*>(made->getModuleByPath(".wlan.mgmt"));
    Start(made);
    if (air.interfaces[radio].empty())
    {
        cModule* queue = Make("skyrange.FrameQueue", ("queue" + std::to_string(radio)).c_str());
        queue->finalizeParameters();
        queue->buildInside();
        Start(queue);
        found->queue = check_and_cast<FrameQueue*>(queue);
    }
    else
    {
        found->queue = air.interfaces[radio].front()->queue;
    }
    air.interfaces[radio].push_back(found);
    air.medium->PickUp(found);
    return found;
}

} // namespace skyrange
