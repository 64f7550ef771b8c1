// The module that makes the others and hands them what the requests say.
// SPDX-License-Identifier: MIT
#ifndef SKYRANGE_OMNETPP_CONTROLLER_H
#define SKYRANGE_OMNETPP_CONTROLLER_H

#include "air.h"

namespace skyrange
{

class Controller : public omnetpp::cSimpleModule
{
  public:
    /// Make the buildings and the medium.
    void Begin(medium_protocol::Hello hello);

    /// Take positions, and schedule transmissions and noise.
    void Take(const medium_protocol::Advance& advance);

  protected:
    void handleMessage(omnetpp::cMessage* message) override;

  private:
    struct NoiseBegins;
    struct NoiseEnds;

    omnetpp::cModule* Make(const char* type, const char* name);
    void Start(omnetpp::cModule* module);
    ObservedRadio* Interface(uint32_t radio, uint16_t channel, uint16_t waveform);
    void Offer(int64_t key);
    void BeginNoise(const NoiseBegins& begins);
};

} // namespace skyrange

#endif
