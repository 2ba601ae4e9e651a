/* Closest approaches, for pipeline/orbit/closest.py: the least distance of motions from the origin.

   On a stretch of a relative motion the position is a cubic Bezier curve c(s), 0 <= s <= 1, in m,
   up to a remainder. Arrays are contiguous. Results consist of sums, products, quotients and square
   roots in a fixed order, so that they are the same bits on every machine, whatever is searched
   beside. */
#include <math.h>
#include <stdint.h>

enum {
  POINTS = 12,        /* Chebyshev coefficients of a piece, as in chebyshev.py */
  NEWTON_STEPS = 2,   /* enough to be within rounding of a minimum where motion is nearly uniform */
  MOST_SPLITS = 40,   /* more than enough: each at least quarters the error of the bracket */
  AT_ONCE = 64        /* parts of a motion that are searched at once */
};
static const double MOST_PARTS = 1e9;   /* of a motion: more are for no craft about the Earth */
static const double EDGE = 0.02;        /* closest this near to an end, it is split in the middle */
static const double NO_LENGTH = 1e-300; /* m^2, added so that a chord of length 0 divides nothing */

typedef double Vector[3];
typedef Vector Curve[4];

typedef struct {
  Curve curve;
  double begin, width;        /* where it lies in its motion, as shares of that */
  double closest, distance;   /* where it is closest to the origin, 0 to 1, and how close, m */
  int splits;                 /* that led to it */
} Stretch;

/* The source that this was compiled from, by its digest. */
const char *source(void) { return SOURCE; }

static double smaller(double a, double b) { return b < a ? b : a; }
static double larger(double a, double b) { return b > a ? b : a; }
static double share(double s) { return smaller(larger(s, 0), 1); } /* the nearest in 0 to 1 */

static double dot(const Vector a, const Vector b) {
  return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

/* Where on a chord from a point it is closest to the origin, 0 to 1. */
static double along(const Vector begin, const Vector chord) {
  return share(-dot(begin, chord) / (dot(chord, chord) + NO_LENGTH));
}

/* Distance of a chord from the origin. */
static double chord_distance(const Vector begin, const Vector chord) {
  double s = along(begin, chord);
  Vector point;
  for (int d = 0; d < 3; d++) point[d] = begin[d] + s * chord[d];
  return sqrt(dot(point, point));
}

/* Quick lower bound on a curve's distance from the origin, by its chord and its bend. */
static double chord_bound(const Curve c) {
  Vector chord, leave, come;
  for (int d = 0; d < 3; d++) {
    chord[d] = c[3][d] - c[0][d];
    leave[d] = 3 * (c[1][d] - c[0][d]) - chord[d];
    come[d] = 3 * (c[3][d] - c[2][d]) - chord[d];
  }
  double bend = larger(dot(leave, leave), dot(come, come));
  return chord_distance(c[0], chord) - 0.25 * sqrt(bend);
}

/* Lower bound on a curve's distance: the least Bernstein coefficient of its square. */
static double hull_bound(const Curve c) {
  double least = dot(c[0], c[0]), found[] = {
    dot(c[0], c[1]),
    (2 * dot(c[0], c[2]) + 3 * dot(c[1], c[1])) / 5,
    (dot(c[0], c[3]) + 9 * dot(c[1], c[2])) / 10,
    (2 * dot(c[1], c[3]) + 3 * dot(c[2], c[2])) / 5,
    dot(c[2], c[3]),
    dot(c[3], c[3]),
  };
  for (int k = 0; k < 6; k++) least = smaller(least, found[k]);
  return least > 0 ? sqrt(least) : 0;
}

/* Find by Newton's method where a stretch is closest to the origin. */
static void find_closest(Stretch *of) {
  const Vector *c = of->curve;
  Vector power[4], chord, point; /* c by powers of s */
  for (int d = 0; d < 3; d++) {
    chord[d] = c[3][d] - c[0][d];
    power[0][d] = c[0][d];
    power[1][d] = 3 * (c[1][d] - c[0][d]);
    power[2][d] = 3 * (c[0][d] - 2 * c[1][d] + c[2][d]);
    power[3][d] = chord[d] + 3 * (c[1][d] - c[2][d]);
  }
  double s = along(c[0], chord);
  for (int step = 0; step < NEWTON_STEPS; step++) {
    double slope = 0, bend = 0; /* derivatives of half the squared distance */
    for (int d = 0; d < 3; d++) {
      double at = power[0][d] + s * (power[1][d] + s * (power[2][d] + s * power[3][d]));
      double rate = power[1][d] + s * (2 * power[2][d] + s * 3 * power[3][d]);
      slope += at * rate;
      bend += rate * rate + at * (2 * power[2][d] + s * 6 * power[3][d]);
    }
    if (bend > 0) s -= slope / bend; /* where the squared distance is not convex, s stays */
    s = share(s);
  }
  double r = 1 - s, weight[] = {r * r * r, 3 * r * r * s, 3 * r * s * s, s * s * s};
  for (int d = 0; d < 3; d++) {
    point[d] = 0;
    for (int k = 0; k < 4; k++) point[d] += weight[k] * c[k][d];
  }
  of->closest = s;
  of->distance = sqrt(dot(point, point));
}

/* Split a stretch at a share of it, by de Casteljau's algorithm. */
static void split(const Stretch *whole, double at, Stretch half[2]) {
  for (int d = 0; d < 3; d++) {
    double c[4];
    for (int k = 0; k < 4; k++) c[k] = whole->curve[k][d];
    for (int k = 0; k < 4; k++) {
      half[0].curve[k][d] = c[0];
      half[1].curve[3 - k][d] = c[3 - k];
      for (int j = 0; j < 3 - k; j++) c[j] += at * (c[j + 1] - c[j]);
    }
  }
  half[0].begin = whole->begin;
  half[0].width = whole->width * at;
  half[1].begin = whole->begin + whole->width * at;
  half[1].width = whole->width * (1 - at);
  half[0].splits = half[1].splits = whole->splits + 1;
}

/* The search for the closest point of a motion: what is asked, what is left, what is known. */
typedef struct {
  double remainder, within, tolerance; /* m */
  Stretch open[AT_ONCE + MOST_SPLITS]; /* that may be closest */
  int count;
  double when, distance; /* the closest point that was found: share of the motion, and m */
  double bound;          /* below the distances of all stretches that are not open, m */
} Search;

static void begin_search(Search *search, double remainder, double within, double tolerance) {
  search->remainder = remainder;
  search->within = within;
  search->tolerance = tolerance;
  search->count = 0;
  search->when = 0;
  search->distance = search->bound = INFINITY;
}

/* Add a stretch that may be closest. */
static void add(Search *search, const Stretch *stretch) {
  Stretch *of = &search->open[search->count++];
  *of = *stretch;
  find_closest(of);
  if (of->distance < search->distance) {
    search->distance = of->distance;
    search->when = of->begin + of->width * of->closest;
  }
}

/* Whether a lower bound rules out that a stretch is closer, by the tolerance, or matters. */
static int rules_out(Search *search, double lower) {
  double enough = search->distance - search->remainder - search->tolerance;
  int out = lower > search->within || lower >= enough;
  if (out) search->bound = smaller(search->bound, lower);
  return out;
}

/* Split open stretches where they are closest until none may be closer by the tolerance.

   On either side of there the squared distance mostly grows, which its Bernstein coefficients prove
   at once. */
static void finish(Search *search) {
  Stretch half[2];
  while (search->count) {
    Stretch whole = search->open[--search->count];
    split(&whole, fabs(whole.closest - 0.5) < 0.5 - EDGE ? whole.closest : 0.5, half);
    for (int k = 0; k < 2; k++) {
      double lower = hull_bound(half[k].curve) - search->remainder;
      if (rules_out(search, lower)) continue;
      if (half[k].splits < MOST_SPLITS)
        add(search, &half[k]);
      else
        search->bound = smaller(search->bound, lower);
    }
  }
}

/* The cubic with the states of both ends, h s apart: positions and velocities, in scaled axes. */
static void hermite(const double start[6], const double end[6], double h, const double *scale,
                    Curve c) {
  for (int d = 0; d < 3; d++) {
    double axis = scale ? scale[d] : 1;
    c[0][d] = axis * start[d];
    c[1][d] = axis * (start[d] + h / 3 * start[3 + d]);
    c[2][d] = axis * (end[d] - h / 3 * end[3 + d]);
    c[3][d] = axis * end[d];
  }
}

/* Closest points of cubics over h s with states at both ends, (cubics, 6), and remainders, m.

   When, as a share, how close, and a bound on that, which alone is known beyond `within`. */
void closest_of_cubics(int64_t cubics, double h, double tolerance, const double *start,
                       const double *end, const double *scale, const double *remainder,
                       const double *within, double *when, double *distance, double *bound) {
  Search search;
  for (int64_t k = 0; k < cubics; k++) {
    Stretch whole = {.begin = 0, .width = 1, .splits = 0};
    begin_search(&search, remainder[k], within[k], tolerance);
    hermite(start + 6 * k, end + 6 * k, h, scale ? scale + 3 * k : 0, whole.curve);
    if (!rules_out(&search, chord_bound(whole.curve) - remainder[k])) {
      add(&search, &whole);
      finish(&search);
    }
    when[k] = search.when;
    distance[k] = search.distance;
    bound[k] = search.bound;
  }
}

/* Linear motion in intervals of constant control, as LinearMotion in closest.py.

   State and control, nine numbers, determine the motion in an interval: its state is a polynomial
   in pieces of that. Where there is one interval, all are the same. */
typedef struct {
  int64_t intervals, pieces, rows;
  const double *series; /* (intervals, pieces, POINTS, 6, 9): Chebyshev coefficients of maps */
  const double *fourth; /* (intervals, rows, 9): maps whose norm bounds the fourth derivative */
  double half;          /* of a piece's length, s */
  int32_t absolute;     /* whether `fourth` is for absolute values of state and control */
} LinearMotion;

typedef double State[6];
typedef double Map[6][9];

/* The piece of an interval at a time, s, and the Chebyshev polynomials there. */
static int64_t basis(const LinearMotion *linear, double time, double polynomial[POINTS]) {
  double along = time / (2 * linear->half);
  int64_t piece = along < (double)linear->pieces ? (int64_t)along : linear->pieces - 1;
  double u = 2 * (along - (double)piece) - 1;
  polynomial[0] = 1;
  polynomial[1] = u;
  for (int q = 2; q < POINTS; q++) polynomial[q] = 2 * u * polynomial[q - 1] - polynomial[q - 2];
  return piece;
}

/* Coefficients of the maps in a piece of an interval. */
static const Map *maps_of(const LinearMotion *linear, int64_t interval, int64_t piece) {
  if (linear->intervals == 1) interval = 0;
  return (const Map *)linear->series + (interval * linear->pieces + piece) * POINTS;
}

/* The map from state and control at an interval's start to the state at a time. */
static void map_at(const LinearMotion *linear, int64_t interval, double time, Map map) {
  double polynomial[POINTS];
  const Map *maps = maps_of(linear, interval, basis(linear, time, polynomial));
  for (int i = 0; i < 6; i++)
    for (int j = 0; j < 9; j++) {
      map[i][j] = 0;
      for (int q = 0; q < POINTS; q++) map[i][j] += polynomial[q] * maps[q][i][j];
    }
}

static void apply(const Map map, const double given[9], State state) {
  for (int i = 0; i < 6; i++) {
    state[i] = 0;
    for (int j = 0; j < 9; j++) state[i] += map[i][j] * given[j];
  }
}

/* A motion in an interval, and its coefficients in the piece that was asked for last. */
typedef struct {
  const LinearMotion *linear;
  int64_t interval;
  const double *given, *scale; /* state and control at the start; scales of the axes, or none */
  double fourth;               /* bound on the fourth derivative of position, m/s^4 */
  int64_t piece;
  State series[POINTS];
} Motion;

static void begin_motion(Motion *motion) {
  const LinearMotion *linear = motion->linear;
  const double *maps = linear->fourth;
  if (linear->intervals > 1) maps += motion->interval * linear->rows * 9;
  double squares = 0;
  for (int64_t i = 0; i < linear->rows; i++, maps += 9) {
    double row = 0;
    for (int j = 0; j < 9; j++)
      row += maps[j] * (linear->absolute ? fabs(motion->given[j]) : motion->given[j]);
    squares += row * row;
  }
  motion->fourth = sqrt(squares);
  motion->piece = -1;
}

static void state_at(Motion *motion, double time, State state) {
  double polynomial[POINTS];
  int64_t piece = basis(motion->linear, time, polynomial);
  if (piece != motion->piece) {
    const Map *maps = maps_of(motion->linear, motion->interval, piece);
    for (int q = 0; q < POINTS; q++) apply(maps[q], motion->given, motion->series[q]);
    motion->piece = piece;
  }
  for (int i = 0; i < 6; i++) {
    state[i] = 0;
    for (int q = 0; q < POINTS; q++) state[i] += polynomial[q] * motion->series[q][i];
  }
}

/* Bound on how far a motion is from the cubic with its states at both ends, over h s, m. */
static double cubic_error(const Motion *motion, double h) {
  return h * h * h * h / 384 * motion->fourth;
}

/* Search a stretch of a motion over h s of its interval's `whole`; its end becomes its start.

   In equal parts, as many as there must be for cubics to err by no more than the search says; too
   many are cut into groups first. */
static void search_stretch(Search *search, Motion *motion, double whole, double from, double h,
                           State start) {
  double parts = ceil(sqrt(sqrt(cubic_error(motion, h) / search->remainder)));
  if (parts > MOST_PARTS) {
    search->bound = 0; /* which holds for any motion */
    return;
  }
  int64_t count = parts <= AT_ONCE ? (int64_t)larger(parts, 1) : AT_ONCE;
  double length = h / (double)count;
  State end;
  Stretch one = {.width = length / whole, .splits = 0};
  for (int64_t part = 0; part < count; part++) {
    double begin = from + (double)part * length;
    state_at(motion, begin + length, end);
    hermite(start, end, length, motion->scale, one.curve);
    one.begin = begin / whole;
    if (!rules_out(search, chord_bound(one.curve) - cubic_error(motion, length))) {
      if (parts <= AT_ONCE)
        add(search, &one);
      else
        search_stretch(search, motion, whole, begin, length, start);
    }
    for (int i = 0; i < 6; i++) start[i] = end[i];
  }
  finish(search);
}

/* What is found of a motion, as FOUND in closest.py. */
typedef struct {
  int64_t index;
  double offset, distance, bound; /* s from the interval's start, m, m */
  double state_map[3][6], control_map[3][3]; /* to the position then */
} Found;

/* Find the closest point of a motion over h s, if it may come within its reach; else return 0. */
static int find_motion(Motion *motion, double h, double tolerance, double within, const Map to_end,
                       Found *found) {
  Search search;
  State start, end;
  Curve curve;
  Map there;
  begin_motion(motion);
  for (int i = 0; i < 6; i++) start[i] = motion->given[i];
  apply(to_end, motion->given, end);
  hermite(start, end, h, motion->scale, curve);
  if (!(chord_bound(curve) - cubic_error(motion, h) <= within)) return 0;
  /* A quarter of the tolerance on either side is for the error of cubics. */
  begin_search(&search, tolerance / 4, within, tolerance / 2);
  search_stretch(&search, motion, h, 0, h, start);
  if (!(search.bound <= within)) return 0;
  found->offset = search.when * h;
  map_at(motion->linear, motion->interval, found->offset, there);
  apply(there, motion->given, end);
  for (int d = 0; d < 3; d++) {
    end[d] *= motion->scale ? motion->scale[d] : 1;
    for (int j = 0; j < 6; j++) found->state_map[d][j] = there[d][j];
    for (int j = 0; j < 3; j++) found->control_map[d][j] = there[d][6 + j];
  }
  found->bound = search.bound;
  found->distance = larger(sqrt(dot(end, end)), search.bound);
  return 1;
}

/* Closest points to the origin of those motions over h s that may come within their reach.

   Motions are states and controls, (motions, 9), at starts of intervals. Returns how many it
   found. */
int64_t closest_of_motions(const LinearMotion *linear, int64_t motions, double h, double tolerance,
                           const double *given, const int64_t *interval, const double *scale,
                           const double *within, Found *found) {
  Motion motion = {.linear = linear};
  Map to_end;
  int64_t count = 0;
  for (int64_t m = 0; m < motions; m++) {
    if (m == 0 || (interval[m] != interval[m - 1] && linear->intervals > 1))
      map_at(linear, interval[m], h, to_end);
    motion.interval = interval[m];
    motion.given = given + 9 * m;
    motion.scale = scale ? scale + 3 * m : 0;
    if (!find_motion(&motion, h, tolerance, within[m], to_end, &found[count])) continue;
    found[count++].index = m;
  }
  return count;
}

/* A ball about the middle of a chord that contains a motion, and how far that strays from it, m. */
typedef struct {
  Vector middle;
  double radius;
  double sag;
} Ball;

/* The same for pairs of craft in each of some intervals from `begin` to before `end`.

   Flown are (craft, intervals, 15): states at both ends of an interval, its end first, and
   controls. A craft strays up to `sag` from its chord, (craft, intervals). An index is that of an
   interval, counted from the first of these, times the number of pairs, and that of a pair. */
int64_t closest_of_pairs(const LinearMotion *linear, int64_t craft, int64_t pairs,
                         int64_t intervals, int64_t begin, int64_t end, double h, double tolerance,
                         const int64_t *first, const int64_t *second, const double *flown,
                         const double *sag, const double *scale, const double *within, Ball *balls,
                         Found *found) {
  Motion motion = {.linear = linear};
  Map to_end;
  double given[9];
  Vector from, chord;
  int64_t count = 0;
  motion.given = given;
  for (int64_t k = begin; k < end; k++) {
    if (k == begin || linear->intervals > 1) map_at(linear, k, h, to_end);
    motion.interval = k;
    for (int64_t i = 0; i < craft; i++) {
      const double *one = flown + 15 * (i * intervals + k);
      for (int d = 0; d < 3; d++) {
        chord[d] = (one[d] - one[6 + d]) / 2;
        balls[i].middle[d] = one[6 + d] + chord[d];
      }
      balls[i].sag = sag[i * intervals + k];
      balls[i].radius = sqrt(dot(chord, chord)) + balls[i].sag;
    }
    for (int64_t p = 0; p < pairs; p++) {
      const Ball *here = balls + first[p], *there = balls + second[p];
      motion.scale = scale ? scale + 3 * p : 0;
      double reach = within[p] + here->radius + there->radius;
      for (int d = 0; d < 3; d++) {
        from[d] = here->middle[d] - there->middle[d];
        if (scale) from[d] *= motion.scale[d];
      }
      if (!(dot(from, from) <= reach * reach)) continue;
      const double *one = flown + 15 * (first[p] * intervals + k);
      const double *other = flown + 15 * (second[p] * intervals + k);
      for (int d = 0; d < 3; d++) {
        double axis = scale ? motion.scale[d] : 1;
        from[d] = axis * (one[6 + d] - other[6 + d]);
        chord[d] = axis * (one[d] - other[d]) - from[d];
      }
      if (!(chord_distance(from, chord) <= within[p] + here->sag + there->sag)) continue;
      for (int d = 0; d < 9; d++) given[d] = one[6 + d] - other[6 + d];
      if (!find_motion(&motion, h, tolerance, within[p], to_end, &found[count])) continue;
      found[count++].index = (k - begin) * pairs + p;
    }
  }
  return count;
}
