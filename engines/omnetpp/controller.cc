// SPDX-License-Identifier: MIT
#include "controller.h"

#include "mac.h"
#include "medium.h"
#include "radio.h"

#include <algorithm>
#include <cmath>
#include <set>

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

// Noise that is this much weaker than what makes a channel busy does not change that by more than 0.4 dB.
const double kNegligibleDb = 10.0;
// Noise is kept for the frames that it overlapped: 2346 bytes in DSSS at 1 Mb/s last 18.96 ms.
const int64_t kLongestFrameMs = 20;

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

/// Rows of noise that begin at one time.
struct Controller::NoiseBegins : public cMessage
{
    std::vector<std::pair<Noise, std::vector<Path>>> rows;
};

/// Radios at which noise ends that may have made the channel busy.
struct Controller::NoiseEnds : public cMessage
{
    std::vector<uint32_t> radios;
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
    air.noise.resize(air.hello.radios.size());

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

    cModule* probe = Make("skyrange.PathProbe", "probe");
    probe->finalizeParameters();
    probe->buildInside();
    Start(probe);
    air.probe = check_and_cast<PathProbe*>(probe);
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
    std::map<int64_t, NoiseBegins*> begins;
    for (const Noise& row : advance.noise)
    {
        NoiseBegins*& message = begins[row.from_ns];
        if (message == nullptr)
        {
            message = new NoiseBegins;
            message->setSchedulingPriority(kNoisePriority);
            scheduleAt(air.ToSimTime(row.from_ns), message);
        }
        const auto first = advance.paths.begin() + row.first_path;
        message->rows.emplace_back(row, std::vector<Path>(first, first + row.paths));
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
        BeginNoise(*noise);
    }
    else if (auto ends = dynamic_cast<NoiseEnds*>(message))
    {
        for (const uint32_t radio : ends->radios)
        {
            for (ObservedRadio* each : TheAir().interfaces[radio])
            {
                each->OnNoise();
            }
        }
    }
    else
    {
        Offer(KeyOf(message));
    }
    delete message;
}

/// Noise is no signal: it adds to the noise of the receivers. Only what may make a channel busy is an event at them.
void
Controller::BeginNoise(const NoiseBegins& begins)
{
    Air& air = TheAir();
    std::map<int64_t, std::set<uint32_t>> changed; // by the end of the noise
    for (const auto& [row, paths] : begins.rows)
    {
        for (const Path& path : paths)
        {
            double dbm = row.power_dbm + path.gain_db;
            if (air.hello.own_losses && row.radio != kNoRadio)
            {
                dbm -= air.medium->LossDb(air.places[row.radio], air.places[path.radio], 1e6 * row.centre_mhz);
            }
            auto& pieces = air.noise[path.radio];
            const simtime_t since = simTime() - SimTime(kLongestFrameMs, SIMTIME_MS);
            pieces.erase(std::remove_if(pieces.begin(), pieces.end(),
                                        [since](const NoisePiece& piece) { return piece.to < since; }),
                         pieces.end());
            pieces.push_back({simTime(), air.ToSimTime(row.to_ns), row.centre_mhz, row.width_mhz, dbm});
            if (dbm > air.settings.energy_detection_dbm - kNegligibleDb)
            {
                changed[row.to_ns].insert(path.radio);
            }
        }
    }
    for (const auto& [to_ns, radios] : changed)
    {
        auto ends = new NoiseEnds;
        ends->radios.assign(radios.begin(), radios.end());
        ends->setSchedulingPriority(kOfferPriority);
        scheduleAt(air.ToSimTime(to_ns), ends);
        for (const uint32_t radio : radios)
        {
            for (ObservedRadio* each : air.interfaces[radio])
            {
                each->OnNoise();
            }
        }
    }
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
    made->par("snirMode").setStringValue(air.settings.snir_mode);
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
    found->Listen();
    return found;
}

} // namespace skyrange
