"""Page of a pair: tracks of both runs, propagation timeline, effects, belief."""
