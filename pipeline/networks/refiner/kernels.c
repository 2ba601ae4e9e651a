/* The refiner's loops over encounters, programs and messages, for geometry.py and programs.py.

   Arrays are contiguous. Node states are (N, T, 6), in units of r_col and the time step. Reals are
   added in a fixed order, so that results are the same bits on every machine. */
#include <math.h>
#include <stddef.h>
#include <stdint.h>

/* The source that this was compiled from, by its digest. */
const char *source(void) { return SOURCE; }

static double smaller(double a, double b) { return b < a ? b : a; }
static double larger(double a, double b) { return b > a ? b : a; }

/* Closest approach within an interval, in which relative motion is a cubic of s, 0 to 1. Numbers
   are those of geometry.py. */

enum { STRETCHES = 6, NEWTON_STEPS = 3 };
static const double EQUAL = 1 + 1e-12, LEVEL = 1e-6;

typedef double Cubic[4][3]; /* coefficients of 1, s, s^2, s^3 */

typedef struct {
  double square, slope, curvature, speed; /* |p|^2, half of its first two derivatives, |v|^2 */
} Distance;

/* States at both ends of an interval, of one craft relative to another. */
static void relative(const double *one, const double *other, double ends[12]) {
  for (int k = 0; k < 12; k++) ends[k] = one[k] - other[k];
}

/* Whether the craft certainly stay beyond a distance.

   The cubic lies within the hull of its four Bezier points; where these are beyond a plane at that
   distance, across the mean of both ends, so is the cubic. */
static int stays_beyond(const double ends[12], double within) {
  double begin = 0, leave = 0, come = 0, end = 0, length = 0;
  for (int x = 0; x < 3; x++) {
    double here = ends[x], go = ends[3 + x], there = ends[6 + x], arrive = ends[9 + x];
    double middle = here + there;
    begin += here * middle;
    leave += (here + go / 3) * middle;
    come += (there - arrive / 3) * middle;
    end += there * middle;
    length += middle * middle;
  }
  double least = smaller(smaller(begin, leave), smaller(come, end));
  return least > 0 && least * least > within * within * length;
}

static void fill_cubic(Cubic motion, const double ends[12]) {
  for (int x = 0; x < 3; x++) {
    double here = ends[x], go = ends[3 + x], there = ends[6 + x], arrive = ends[9 + x];
    motion[0][x] = here;
    motion[1][x] = go;
    motion[2][x] = 3 * (there - here) - 2 * go - arrive;
    motion[3][x] = 2 * (here - there) + go + arrive;
  }
}

static Distance distance_at(const Cubic motion, double s) {
  Distance at = {0, 0, 0, 0};
  for (int x = 0; x < 3; x++) {
    double p0 = motion[0][x], v0 = motion[1][x], a2 = motion[2][x], a3 = motion[3][x];
    double p = p0 + s * (v0 + s * (a2 + s * a3)), v = v0 + s * (2 * a2 + 3 * s * a3);
    at.square += p * p;
    at.slope += p * v;
    at.curvature += v * v + p * (2 * a2 + 6 * s * a3);
    at.speed += v * v;
  }
  return at;
}

static void position_at(const Cubic motion, double s, double p[3]) {
  for (int x = 0; x < 3; x++)
    p[x] = motion[0][x] + s * (motion[1][x] + s * (motion[2][x] + s * motion[3][x]));
}

/* Distance of the closest approach to 0, and when it is. */
static double closest(const Cubic motion, double *when) {
  double least = INFINITY, here[3], there[3], square = 0;
  *when = 0;
  position_at(motion, 0, here);
  for (int stretch = 0; stretch <= STRETCHES; stretch++) {
    /* Where craft pass each other fast, the closest sample may be far from there. */
    square = here[0] * here[0] + here[1] * here[1] + here[2] * here[2];
    if (square < least) {
      *when = (double)stretch / STRETCHES;
      least = square;
    }
    if (stretch == STRETCHES) break;
    position_at(motion, (stretch + 1.0) / STRETCHES, there);
    double along = 0, length = 0;
    for (int x = 0; x < 3; x++) {
      along += here[x] * (here[x] - there[x]);
      length += (there[x] - here[x]) * (there[x] - here[x]);
      here[x] = there[x];
    }
    if (0 < along && along < length) { /* the straight way between both is closest on its way */
      double s = (stretch + along / length) / STRETCHES;
      square = distance_at(motion, s).square;
      if (square < least) {
        *when = s;
        least = square;
      }
    }
  }
  /* The least of a smooth curve is near the least of these, so no step goes further. */
  double low = larger(*when - 1.0 / STRETCHES, 0), high = smaller(*when + 1.0 / STRETCHES, 1);
  double s = *when;
  for (int k = 0; k < NEWTON_STEPS; k++) {
    Distance at = distance_at(motion, s);
    double sign = at.slope > 0 ? 1 : at.slope < 0 ? -1 : 0;
    s -= at.curvature > 0 ? at.slope / at.curvature : sign * (high - low) / 4;
    s = smaller(larger(s, low), high);
    square = distance_at(motion, s).square;
    if (square <= least * EQUAL) {
      *when = s;
      least = smaller(square, least);
    }
  }
  return sqrt(least);
}

/* The closest approach of pairs of craft in intervals, into the last three arrays.

   Those are as in EncounterGeometry. Results of pairs of which neither craft has `moved` stay;
   where the pair surely stays beyond `within`, share and distance are 0 and infinite. */
void nearest(int64_t pairs, int64_t nodes, const double *states, const int64_t *first,
             const int64_t *second, const int64_t *interval, const double *within,
             const uint8_t *moved, double *share, double *distance, uint8_t *is_minimum) {
  double ends[12];
  Cubic motion;
  for (int64_t k = 0; k < pairs; k++) {
    if (!moved[first[k]] && !moved[second[k]]) continue;
    relative(states + (first[k] * nodes + interval[k]) * 6,
             states + (second[k] * nodes + interval[k]) * 6, ends);
    if (stays_beyond(ends, within[k])) {
      share[k] = 0;
      distance[k] = INFINITY;
      is_minimum[k] = 0;
      continue;
    }
    fill_cubic(motion, ends);
    distance[k] = closest(motion, &share[k]);
    Distance at = distance_at(motion, share[k]);
    int stationary = at.slope * at.slope <= LEVEL * LEVEL * at.square * at.speed;
    is_minimum[k] = (share[k] > 0 && share[k] < 1) || stationary;
  }
}

/* All pairs of the same swarm of n craft, and intervals in which they come within a distance.

   Distances are one for each swarm. Found are first craft, second craft and interval, one after the
   other, as many as there is room for; returned is how many there are. */
int64_t close_pairs(int64_t craft, int64_t nodes, int64_t n, const double *states,
                    const double *within, int64_t room, int64_t *found) {
  double ends[12], when;
  Cubic motion;
  int64_t count = 0;
  for (int64_t i = 0; i < craft; i++) {
    double distance = within[i / n];
    for (int64_t j = i + 1; j < (i / n + 1) * n; j++)
      for (int64_t t = 0; t < nodes - 1; t++) {
        relative(states + (i * nodes + t) * 6, states + (j * nodes + t) * 6, ends);
        if (stays_beyond(ends, distance)) continue;
        fill_cubic(motion, ends);
        double begin = distance_at(motion, 0).square, end = distance_at(motion, 1).square;
        /* Most that come within are there at one of their ends. */
        if (smaller(begin, end) > distance * distance && closest(motion, &when) > distance)
          continue;
        if (count < room) {
          found[3 * count] = i;
          found[3 * count + 1] = j;
          found[3 * count + 2] = t;
        }
        count++;
      }
  }
  return count;
}

static double dot(const double *a, const double *b, int64_t count) {
  double part[4] = {0}, sum = 0;
  int64_t k = 0;
  for (; k + 4 <= count; k += 4)
    for (int j = 0; j < 4; j++) part[j] += a[k + j] * b[k + j];
  for (; k < count; k++) sum += a[k] * b[k];
  return sum + ((part[0] + part[1]) + (part[2] + part[3]));
}

/* Message aggregation: sums over each craft's other encounters, added to `result`, which is zero.

   Messages, (L, 2, 2 H), have the terms of the sum by cosines and those of the other; `free` are
   the planes' normals, (L, m), and sides those of Sides. */
void add_up(int64_t craft, int64_t m, int64_t H, const double *messages, const double *free,
            const int64_t *start, const int64_t *order, double *result) {
  for (int64_t c = 0; c < craft; c++)
    for (int64_t a = start[c]; a < start[c + 1]; a++) {
      const double *mine = messages + order[a] * 2 * H, *normal = free + (order[a] >> 1) * m;
      double *sum = result + order[a] * 2 * H, *every = result + order[start[c]] * 2 * H + H;
      for (int64_t h = 0; h < H; h++) every[h] += mine[H + h];
      for (int64_t b = start[c]; b <= a; b++) {
        const double *others = messages + order[b] * 2 * H, *across = free + (order[b] >> 1) * m;
        double *into = result + order[b] * 2 * H, cosine = dot(normal, across, m);
        if ((order[a] ^ order[b]) & 1) cosine = -cosine;
        for (int64_t h = 0; h < H; h++) sum[h] += cosine * others[h];
        if (a != b)
          for (int64_t h = 0; h < H; h++) into[h] += cosine * mine[h];
      }
    }
  for (int64_t c = 0; c < craft; c++)
    for (int64_t a = start[c] + 1; a < start[c + 1]; a++)
      for (int64_t h = 0; h < H; h++)
        result[order[a] * 2 * H + H + h] = result[order[start[c]] * 2 * H + H + h];
}

/* Each craft's own program, by the dual simplex method on its tableau, as told in programs.py,
   which has these numbers, too. */

static const double SMALL = 1e-9;     /* what counts as 0 among the values of variables, r_col */
static const double NO_PIVOT = 1e-11; /* smaller entries of a tableau are no pivots */
/* Difference of duals that counts as none: where several optima cost the same, the earliest control
   enters, or rounding and the order of planes would choose between them. */
static const double TIE = 1e-6;
static const double STEEP = 0.1; /* least size of a pivot, as a share of the largest among ties */

typedef struct {
  int64_t m, columns;      /* controls; nonbasic variables, m - 6 */
  double largest;          /* dual up to which a plane is kept */
  int64_t rows;            /* basic variables */
  double *body;            /* (rows, columns) */
  double *value, *side;    /* of the basic variables, and the side of 0 where their cost is taken */
  double *cost, *ratio;    /* of the nonbasic ones */
  int64_t *basic, *other;  /* which they are: controls, and from m on slacks of planes */
} Program;

/* Slopes of a variable's cost below and above 0. */
static double slope_below(const Program *of, int64_t variable) {
  return variable < of->m ? -1 : -of->largest;
}
static double slope_above(const Program *of, int64_t variable) { return variable < of->m ? 1 : 0; }

/* The nonbasic variable that enters for one that leaves its side: the first of the cheapest.

   `ratio` becomes the dual of the leaving variable's row, `line`, at which each would enter. */
static int64_t entering_variable(const Program *of, double sign, const double *line) {
  double least = INFINITY, steepest = 0;
  int64_t found = -1;
  for (int64_t k = 0; k < of->columns; k++) {
    double slope = sign * line[k];
    of->ratio[k] = INFINITY;
    if (fabs(slope) >= NO_PIVOT) {
      double kink = slope > 0 ? slope_below(of, of->other[k]) : slope_above(of, of->other[k]);
      of->ratio[k] = larger((of->cost[k] - kink) / slope, 0);
    }
    least = smaller(least, of->ratio[k]);
  }
  for (int64_t k = 0; k < of->columns; k++)
    if (of->ratio[k] <= least + TIE) steepest = larger(steepest, fabs(line[k]));
  for (int64_t k = 0; k < of->columns; k++)
    if (of->ratio[k] <= least + TIE && fabs(line[k]) >= STEEP * steepest)
      if (found < 0 || of->other[k] < of->other[found]) found = k;
  return found;
}

/* Exchange a basic and a nonbasic variable. */
static void exchange(Program *of, int64_t leaving, int64_t entering) {
  double *line = of->body + leaving * of->columns, inverse = 1 / line[entering];
  double amount = of->value[leaving] * inverse;
  for (int64_t k = 0; k < of->columns; k++) line[k] *= inverse;
  line[entering] = inverse;
  for (int64_t i = 0; i < of->rows; i++) {
    double *row = of->body + i * of->columns, share = row[entering];
    if (i == leaving || share == 0) continue;
    for (int64_t k = 0; k < of->columns; k++) row[k] -= share * line[k];
    row[entering] = -share * inverse;
    of->value[i] -= share * amount;
  }
  of->value[leaving] = amount;
  int64_t variable = of->basic[leaving];
  of->basic[leaving] = of->other[entering];
  of->other[entering] = variable;
}

/* One step: the worst infeasible variable changes side or leaves; 0 if there is none. */
static int pivot(Program *of) {
  int64_t leaving = of->rows;
  double worst = SMALL;
  for (int64_t i = 0; i < of->rows; i++)
    if (-of->value[i] * of->side[i] > worst) {
      leaving = i;
      worst = -of->value[i] * of->side[i];
    }
  if (leaving == of->rows) return 0;
  double sign = of->side[leaving], *line = of->body + leaving * of->columns;
  int64_t entering = entering_variable(of, sign, line);
  double low = slope_below(of, of->basic[leaving]), high = slope_above(of, of->basic[leaving]);
  int over = high - low <= of->ratio[entering];
  double step = over ? high - low : of->ratio[entering];
  for (int64_t k = 0; k < of->columns; k++) of->cost[k] -= step * sign * line[k];
  if (over) {
    of->side[leaving] = -sign;
  } else {
    double steep = sign * line[entering];
    exchange(of, leaving, entering);
    of->side[leaving] = steep > 0 ? -1 : 1;
    of->cost[entering] = sign > 0 ? high - step : low + step;
  }
  return 1;
}

/* Append the slack of plane p as a row, expressed by the present nonbasic variables. */
static void add_row(Program *of, int64_t p, double left, double sign, const double *gain) {
  int64_t i = of->rows++;
  double *row = of->body + i * of->columns;
  of->value[i] = left;
  of->side[i] = 1;
  of->basic[i] = of->m + p;
  for (int64_t k = 0; k < of->columns; k++)
    row[k] = of->other[k] < of->m ? -sign * gain[of->other[k]] : 0;
  for (int64_t b = 0; b < i; b++) {
    if (of->basic[b] >= of->m) continue;
    double share = sign * gain[of->basic[b]], *line = of->body + b * of->columns;
    for (int64_t k = 0; k < of->columns; k++) row[k] += share * line[k];
  }
}

/* Read duals off the tableau, and the derivatives of controls by the effects required, if asked. */
static void read_duals(const Program *of, const int64_t *mine, double *dual, double *change) {
  for (int64_t i = 0; i < of->rows; i++)
    if (of->basic[i] >= of->m && of->side[i] < 0) /* the plane is violated */
      dual[mine[of->basic[i] - of->m]] = of->largest;
  for (int64_t k = 0; k < of->columns; k++) {
    if (of->other[k] < of->m) continue;
    int64_t side = mine[of->other[k] - of->m];
    dual[side] = smaller(larger(-of->cost[k], 0), of->largest); /* ties may take it beyond */
    if (!change) continue;
    for (int64_t i = 0; i < of->rows; i++)
      if (of->basic[i] < of->m)
        change[side * of->m + of->basic[i]] = -of->body[i * of->columns + k];
  }
}

/* The optimum of each of the programs of some craft.

   The first six arrays are the fields of Decoupled, the next three those of Sides; gain (L, m),
   required (L, 2) and largest are g, d and Lambda. Results are controls (programs, m), and what
   begins as zeros: duals (L, 2), and, if wanted, derivatives of controls by what is required,
   (L, 2, m). A plane has two sides, 2 l and 2 l + 1, for the two craft between which it is. Work
   arrays have (6 + most) (m - 4) + 2 m numbers and m + 2 most whole ones, where a craft has at most
   `most` planes. */
void solve_all(int64_t programs, int64_t m, int64_t pivots, double largest, const double *tableau,
               const double *own, const int64_t *basis, const int64_t *others, const double *sides,
               const double *costs, const int64_t *craft_of, const int64_t *start,
               const int64_t *order, const double *gain, const double *required, int64_t most,
               double *numbers, int64_t *whole, double *controls, double *dual, double *change) {
  int64_t columns = m - 6, height = 6 + most;
  Program of = {.m = m, .columns = columns, .largest = largest};
  of.value = numbers;
  of.side = of.value + height;
  of.cost = of.side + height;
  of.ratio = of.cost + columns;
  of.body = of.ratio + columns;
  of.basic = whole;
  of.other = of.basic + height;
  int64_t *there = of.other + columns;
  for (int64_t c = 0; c < programs; c++) {
    int64_t craft = craft_of[c], count = start[c + 1] - start[c], before;
    const int64_t *mine = order + start[c];
    double *u = controls + c * m;
    for (int64_t k = 0; k < m; k++) u[k] = own[craft * m + k];
    for (int64_t k = 0; k < columns; k++) {
      of.other[k] = others[craft * columns + k];
      of.cost[k] = costs[craft * columns + k];
    }
    for (int64_t i = 0; i < 6; i++) {
      of.basic[i] = basis[craft * 6 + i];
      of.side[i] = sides[craft * 6 + i];
      of.value[i] = u[of.basic[i]];
    }
    for (int64_t k = 0; k < 6 * columns; k++) of.body[k] = tableau[craft * 6 * columns + k];
    of.rows = 6;
    for (int64_t p = 0; p < count; p++) there[p] = 0;
    do { /* the optimum without their rows satisfies most planes, which then need none */
      before = of.rows;
      for (int64_t p = 0; p < count; p++) {
        if (there[p]) continue;
        const double *row = gain + (mine[p] >> 1) * m;
        double sign = mine[p] & 1 ? -1 : 1, left = sign * dot(row, u, m) - required[mine[p]];
        if (left >= -SMALL) continue;
        there[p] = 1;
        add_row(&of, p, left, sign, row);
      }
      if (of.rows == before) break;
      for (int64_t k = 0; k < pivots && pivot(&of); k++) continue;
      for (int64_t k = 0; k < m; k++) u[k] = 0;
      for (int64_t i = 0; i < of.rows; i++)
        if (of.basic[i] < m) u[of.basic[i]] = of.value[i];
    } while (1);
    read_duals(&of, mine, dual, change);
  }
}

/* The cost to craft of the first unit along rows (count, m): the dual simplex ratio. */
void first_ratios(int64_t count, int64_t m, const double *tableau, const int64_t *basis,
                  const int64_t *others, const double *costs, const int64_t *craft_of,
                  const double *gain, double *moved, double *dual) {
  int64_t columns = m - 6;
  for (int64_t c = 0; c < count; c++, gain += m) {
    int64_t craft = craft_of[c];
    double least = INFINITY;
    for (int64_t k = 0; k < columns; k++) moved[k] = gain[others[craft * columns + k]];
    for (int64_t b = 0; b < 6; b++) {
      const double *row = tableau + (craft * 6 + b) * columns, share = gain[basis[craft * 6 + b]];
      for (int64_t k = 0; k < columns; k++) moved[k] -= share * row[k];
    }
    for (int64_t k = 0; k < columns; k++) {
      double size = fabs(moved[k]), cost = costs[craft * columns + k];
      double rise = moved[k] > 0 ? 1 - cost : 1 + cost;
      /* The sign of a rounding error has no meaning. */
      least = smaller(least, size < SMALL ? 1 / SMALL : rise / size);
    }
    dual[c] = least;
  }
}
