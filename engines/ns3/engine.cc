// ns-3 as a radio engine of skyrange: answers the medium protocol on the socket that is its standard input.
// SPDX-License-Identifier: MIT
#include "../common/medium_protocol.h"
#include "air.h"
#include "given_power_channel.h"
#include "path_loss_models.h"

#include "ns3/constant-position-mobility-model.h"
#include "ns3/node-container.h"
#include "ns3/rng-seed-manager.h"
#include "ns3/simulator.h"

#include <cmath>
#include <csignal>
#include <cstdio>

using namespace ns3;
using namespace medium_protocol;

namespace skyrange
{

class Engine
{
  public:
    explicit Engine(Hello hello)
        : m_channel(CreateObject<GivenPowerChannel>())
    {
        m_air.hello = std::move(hello);
        // 64 bits of seed: ns-3 takes a seed below 2^32 and the number of a run
        RngSeedManager::SetSeed(1 + uint32_t(m_air.hello.seed % 4294944000ULL));
        RngSeedManager::SetRun(1 + (m_air.hello.seed >> 32));
        const size_t count = m_air.hello.radios.size();
        m_nodes.Create(uint32_t(count));
        for (uint32_t k = 0; k < count; k++)
        {
            m_air.mobility.push_back(CreateObject<ConstantPositionMobilityModel>());
            m_nodes.Get(k)->AggregateObject(m_air.mobility.back());
        }
        m_air.present.assign(count, false);
        if (m_air.hello.own_losses)
        {
            m_air.losses = MakeLossModel(m_air.hello);
        }
        m_channel->Setup(&m_air, ParseWifiSettings(m_air.hello.params), m_nodes);
    }

    void AnswerAdvance(Connection& connection, const std::vector<char>& body)
    {
        const Advance advance = DecodeAdvance(body, uint32_t(m_air.hello.radios.size()), m_until_ns);
        for (size_t k = 0; k < advance.places.size(); k++)
        {
            const Place& place = advance.places[k];
            m_air.present[k] = std::isfinite(place.x) && std::isfinite(place.y) && std::isfinite(place.z);
            if (m_air.present[k])
            {
                m_air.mobility[k]->SetPosition(Vector(place.x, place.y, place.z));
            }
        }
        std::map<int64_t, std::vector<Noise>> noise_by_start;
        for (const Noise& noise : advance.noise)
        {
            noise_by_start[noise.from_ns].push_back(noise);
        }
        for (const auto& [from_ns, noises] : noise_by_start)
        {
            // the paths stay: the simulator does not run beyond this call before these events
            Simulator::Schedule(From(from_ns), [this, &advance, &noises = noises] {
                for (const Noise& noise : noises)
                {
                    const auto first = advance.paths.begin() + noise.first_path;
                    m_channel->StartNoise(noise, {first, first + noise.paths});
                }
            });
        }
        for (const Transmission& row : advance.transmissions)
        {
            const auto first = advance.paths.begin() + row.first_path;
            auto frame = std::make_shared<Frame>();
            frame->request = row;
            frame->paths.assign(first, first + row.paths);
            m_air.frames[row.key] = frame;
            Simulator::ScheduleWithContext(m_nodes.Get(row.radio)->GetId(), From(row.at_ns), &Engine::Offer, this, frame);
        }
        // everything happens at whole nanoseconds, so that this comes after all that happens at `until`
        Simulator::Stop(From(advance.until_ns) + PicoSeconds(1));
        Simulator::Run();
        m_until_ns = advance.until_ns;
        connection.AnswerDone(Simulator::GetEventCount(), uint32_t(m_air.frames.size()), m_air.sent, m_air.heard);
        m_air.sent.clear();
        m_air.heard.clear();
    }

    void AnswerPathLosses(Connection& connection, const std::vector<char>& body) const
    {
        Reader reader(body);
        const auto count = reader.Value<uint32_t>();
        reader.Value<uint32_t>();
        const auto ends = reader.Rows<double>(6 * uint64_t(count));
        reader.End();
        std::vector<double> losses_db;
        for (size_t k = 0; k < ends.size(); k += 6)
        {
            // places of their own: the models keep what they found for a pair
            const auto one = CreateObject<ConstantPositionMobilityModel>();
            const auto other = CreateObject<ConstantPositionMobilityModel>();
            one->SetPosition(Vector(ends[k], ends[k + 1], ends[k + 2]));
            other->SetPosition(Vector(ends[k + 3], ends[k + 4], ends[k + 5]));
            CreateObject<Node>()->AggregateObject(one);
            CreateObject<Node>()->AggregateObject(other);
            losses_db.push_back(m_air.losses ? -m_air.losses->CalcRxPower(0.0, one, other) : NAN);
        }
        connection.AnswerLosses(losses_db);
    }

  private:
    void Offer(std::shared_ptr<Frame> frame)
    {
        const auto& request = frame->request;
        if (request.waveform > OFDM_6M || request.channel < 1 || request.channel > 13)
        {
            const int64_t now = m_air.NowNs();
            m_air.sent.push_back({request.key, now, now, request.radio, request.channel, REFUSED});
            m_air.frames.erase(request.key);
            return;
        }
        m_channel->RadioOn(request.radio, request.channel).Offer(frame);
    }

    /// The time from now until a time of the range.
    Time From(int64_t time_ns) const
    {
        return NanoSeconds(time_ns - m_air.hello.origin_ns) - Simulator::Now();
    }

    Air m_air;
    NodeContainer m_nodes;
    Ptr<GivenPowerChannel> m_channel;
    int64_t m_until_ns = INT64_MIN;
};

void
Serve(Connection& connection)
{
    std::vector<char> body;
    if (connection.Receive(body) != HELLO)
    {
        throw Failure("the first request is not HELLO");
    }
    Engine engine(DecodeHello(body));
    connection.AnswerReady({"ns-3",
                            SKYRANGE_NS3_RELEASE,
                            1U << DSSS_1M | 1U << OFDM_6M,
                            FORKS | OWN_LOSSES | REPEATS,
                            0});
    while (true)
    {
        const Type type = connection.Receive(body);
        switch (type)
        {
        case ADVANCE:
            engine.AnswerAdvance(connection, body);
            break;
        case FORK:
            connection.Fork();
            break;
        case PATH_LOSSES:
            engine.AnswerPathLosses(connection, body);
            break;
        default:
            throw Failure("a request of the unknown type " + std::to_string(type));
        }
    }
}

} // namespace skyrange

int
main()
{
    std::signal(SIGCHLD, SIG_IGN); // copies are not waited for
    Time::SetResolution(Time::PS);
    Connection connection;
    try
    {
        skyrange::Serve(connection);
    }
    catch (const EndOfStream&)
    {
        return 0;
    }
    catch (const std::exception& error)
    {
        std::fprintf(stderr, "%s\n", error.what());
        try
        {
            connection.AnswerFailed(error.what());
        }
        catch (const std::exception&)
        {
        }
        return 1;
    }
}
