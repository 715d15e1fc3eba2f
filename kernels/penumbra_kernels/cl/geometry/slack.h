// How much earlier and later than it is a box is met. No unit.

// Every box is met by 16 u (u = 2^-24) times the sum of the largest coordinates of box and origin too early and too
// late: the box's part is in its bounds (compile/bounds.py), the origin's is here. 8 u covers what the triangle test
// moves a triangle sideways (differences, shear: 7 u of the distance to its farthest vertex), so that a ray that leaves
// one triangle for its neighbour finds the neighbour's box; and 8 u what it errs in t, so that no box that holds a hit at
// the current t or before it is skipped, whatever the order of visits.
#define BOX_SLACK 0x1p-20f
// Three roundings on each side of the comparison (Ize 2013).
#define FAR_FACTOR 1.00000036f
