// OMNeT++'s event loop in lockstep with skyrange: answers the medium protocol on the socket that is standard input.
// SPDX-License-Identifier: MIT
#include "controller.h"
#include "medium.h"

#include <algorithm>
#include <csignal>
#include <cstdio>
#include <tuple>

using namespace omnetpp;
using namespace medium_protocol;

namespace skyrange
{

namespace
{

const double kLossHz = 2.437e9; // channel 6, for comparisons of losses

template <typename Row>
bool
EndsBefore(const Row& a, const Row& b)
{
    return std::tie(a.ended_ns, a.key, a.radio) < std::tie(b.ended_ns, b.key, b.radio);
}

} // namespace

/// Runs all events itself, so that an exception of a module becomes FAILED. Cmdenv, which asks for an event, gets none.
class LockstepScheduler : public cScheduler
{
  public:
    std::string str() const override
    {
        return "in lockstep with skyrange";
    }

    cEvent* guessNextEvent() override
    {
        return sim->getFES()->peekFirst();
    }

    void putBackEvent(cEvent* event) override
    {
        sim->getFES()->putBackFirst(event);
    }

    cEvent* takeNextEvent() override
    {
        std::fflush(stdout);
        std::_Exit(Serve());
    }

  private:
    int Serve();
    void AnswerRequests();
    void AnswerAdvance(const std::vector<char>& body);
    void AnswerPathLosses(const std::vector<char>& body);
    void RunUntil(simtime_t until);

    Connection m_connection;
    Controller* m_controller = nullptr;
    int64_t m_until_ns = INT64_MIN;
};

Register_Class(LockstepScheduler);

int
LockstepScheduler::Serve()
{
    std::signal(SIGCHLD, SIG_IGN); // copies are not waited for
    std::string reason;
    try
    {
        AnswerRequests();
    }
    catch (const EndOfStream&)
    {
        return 0;
    }
    catch (const cException& error)
    {
        reason = error.getFormattedMessage();
    }
    catch (const std::exception& error)
    {
        reason = error.what();
    }
    std::fprintf(stderr, "%s\n", reason.c_str());
    try
    {
        m_connection.AnswerFailed(reason);
    }
    catch (const std::exception&)
    {
        return 1;
    }
    return 1;
}

void
LockstepScheduler::AnswerRequests()
{
    std::vector<char> body;
    if (m_connection.Receive(body) != HELLO)
    {
        throw Failure("the first request is not HELLO");
    }
    m_controller = check_and_cast<Controller*>(sim->getSystemModule()->getSubmodule("controller"));
    m_controller->Begin(DecodeHello(body));
    m_connection.AnswerReady({"OMNeT++", SKYRANGE_OMNETPP_RELEASE, 1U << DSSS_1M | 1U << OFDM_6M,
                              FORKS | OWN_LOSSES | REPEATS, 0});
    while (true)
    {
        const Type type = m_connection.Receive(body);
        switch (type)
        {
        case ADVANCE:
            AnswerAdvance(body);
            break;
        case FORK:
            m_connection.Fork();
            break;
        case PATH_LOSSES:
            AnswerPathLosses(body);
            break;
        default:
            throw Failure("a request of the unknown type " + std::to_string(type));
        }
    }
}

void
LockstepScheduler::AnswerAdvance(const std::vector<char>& body)
{
    Air& air = TheAir();
    const Advance advance = DecodeAdvance(body, uint32_t(air.hello.radios.size()), m_until_ns);
    m_controller->Take(advance);
    RunUntil(air.ToSimTime(advance.until_ns));
    m_until_ns = advance.until_ns;
    std::sort(air.sent.begin(), air.sent.end(), EndsBefore<SentRow>);
    std::sort(air.heard.begin(), air.heard.end(), EndsBefore<HeardRow>);
    m_connection.AnswerDone(uint64_t(sim->getEventNumber()), uint32_t(air.frames.size()), air.sent, air.heard);
    air.sent.clear();
    air.heard.clear();
}

/// Run all events up to and including `until`.
void
LockstepScheduler::RunUntil(simtime_t until)
{
    cFutureEventSet* events = sim->getFES();
    while (cEvent* event = events->peekFirst())
    {
        if (event->getArrivalTime() > until)
        {
            return;
        }
        events->removeFirst();
        if (event->isStale())
        {
            delete event;
        }
        else
        {
            sim->executeEvent(event);
        }
    }
}

void
LockstepScheduler::AnswerPathLosses(const std::vector<char>& body)
{
    Reader reader(body);
    const auto count = reader.Value<uint32_t>();
    reader.Value<uint32_t>();
    const auto ends = reader.Rows<double>(6 * uint64_t(count));
    reader.End();
    std::vector<double> losses_db;
    for (size_t k = 0; k < ends.size(); k += 6)
    {
        losses_db.push_back(TheAir().medium->LossDb(inet::Coord(ends[k], ends[k + 1], ends[k + 2]),
                                                    inet::Coord(ends[k + 3], ends[k + 4], ends[k + 5]), kLossHz));
    }
    m_connection.AnswerLosses(losses_db);
}

/// Stands in the place of OMNeT++'s global generator: results would depend on who draws before.
class UnaddressedRng : public cRNG
{
  public:
    void initialize(int, int, int, int, int, cConfiguration*) override
    {
    }

    void selfTest() override
    {
    }

    uint32_t intRand() override
    {
        throw cRuntimeError("a module draws a random number that is not addressed");
    }

    uint32_t intRandMax() override
    {
        return 0xffffffffU;
    }

    uint32_t intRand(uint32_t) override
    {
        return intRand();
    }

    double doubleRand() override
    {
        return intRand();
    }

    double doubleRandNonz() override
    {
        return intRand();
    }

    double doubleRandIncl1() override
    {
        return intRand();
    }
};

Register_Class(UnaddressedRng);

} // namespace skyrange
