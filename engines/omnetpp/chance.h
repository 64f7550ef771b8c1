// Random numbers that depend on what they are drawn for, and on nothing that was drawn before.
// SPDX-License-Identifier: MIT
#ifndef SKYRANGE_OMNETPP_CHANCE_H
#define SKYRANGE_OMNETPP_CHANCE_H

#include <cstdint>
#include <initializer_list>

namespace skyrange
{

/// The finaliser of SplitMix64 (Steele, Lea and Flood, "Fast splittable pseudorandom number generators", 2014).
inline uint64_t
Mix(uint64_t word)
{
    word += 0x9e3779b97f4a7c15ULL;
    word = (word ^ (word >> 30)) * 0xbf58476d1ce4e5b9ULL;
    word = (word ^ (word >> 27)) * 0x94d049bb133111ebULL;
    return word ^ (word >> 31);
}

/// A number in [0, 1) with 53 random bits, addressed by `words`.
inline double
AddressedUniform(std::initializer_list<uint64_t> words)
{
    uint64_t state = 0;
    for (const uint64_t word : words)
    {
        state = Mix(state ^ word);
    }
    return double(Mix(state) >> 11) * 0x1p-53;
}

} // namespace skyrange

#endif
