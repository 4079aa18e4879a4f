/* The laws lms, nlms and rls of a Hammerstein or parallel model, as a C programmer would write them: what the compiled
 * sample loops are measured against (in_c.py compiles it with cc -O3 -march=native -ffast-math).
 *
 * A sample is: the row of Psi into the ring, regressor and prediction (regress), the law's step. That is the law alone;
 * nlms and rls wait until the delay lines hold measured samples and shorten outliers (Huber), rls counts samples for
 * less where the misfit is large and recalls its prior, as its documentation says. No band, no alarm, no standstill, no
 * guard, no counters, no growth. Rows are whole cache lines and three are read at a time, as in core/model/prediction.py.
 */
#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#define LINES(n) (((n) + 7L) & ~7L)
#define LINED(p) __builtin_assume_aligned(p, 64)

static double *room(long n) {
    double *p = aligned_alloc(64, sizeof(double) * LINES(n));
    memset(p, 0, sizeof(double) * LINES(n));
    return p;
}

/* Parameters and regressor in three parts: taps a and g, weights w and psi = A(q) Psi, theory taps b and d. */
typedef struct {
    long taps, weights, theory_taps, size, width, head;
    double *ring, *ring_theory, *a, *w, *b, *g, *psi, *d;
} Model;

static Model model(long taps, long weights, long theory_taps, long width, const double *theta) {
    Model m = {.taps = taps, .weights = weights, .theory_taps = theory_taps, .size = LINES(weights), .width = width};
    m.ring = room(taps * m.size), m.ring_theory = room(theory_taps + 1);
    m.a = room(taps), m.w = room(weights), m.b = room(theory_taps + 1);
    m.g = room(taps), m.psi = room(weights), m.d = room(theory_taps + 1);
    memcpy(m.a, theta, sizeof(double) * taps);
    memcpy(m.w, theta + taps, sizeof(double) * weights);
    memcpy(m.b, theta + taps + weights, sizeof(double) * theory_taps);
    m.head = -1;
    return m;
}

static void parameters(const Model *m, double *theta) {
    memcpy(theta, m->a, sizeof(double) * m->taps);
    memcpy(theta + m->taps, m->w, sizeof(double) * m->weights);
    memcpy(theta + m->taps + m->weights, m->b, sizeof(double) * m->theory_taps);
}

/* theta += step direction */
static void add(Model *m, const double *restrict direction, double step) {
    for (long i = 0; i < m->taps; i++) m->a[i] += step * direction[i];
    for (long i = 0; i < m->weights; i++) m->w[i] += step * direction[m->taps + i];
    for (long i = 0; i < m->theory_taps; i++) m->b[i] += step * direction[m->taps + m->weights + i];
}

static void end(Model *m, double *theta) {
    parameters(m, theta);
    free(m->ring), free(m->ring_theory), free(m->a), free(m->w), free(m->b), free(m->g), free(m->psi), free(m->d);
}

static void push(Model *m, const int32_t *index, const double *value, double theory) {
    const int first = m->head < 0;
    m->head = (m->head + 1) % m->taps;
    double *row = m->ring + m->head * m->size;
    memset(row, 0, sizeof(double) * m->size);
    for (long k = 0; k < m->width; k++) row[index[k]] = value[k];
    for (long i = 1; first && i < m->taps; i++) memcpy(m->ring + i * m->size, row, sizeof(double) * m->size);
    for (long i = 0; first && i < m->theory_taps; i++) m->ring_theory[i] = theory;
    if (m->theory_taps) m->ring_theory[m->head] = theory;
}

static double regress(Model *m) {
    const long n = m->size, taps = m->taps;
    const double *restrict w = LINED(m->w);
    double *restrict psi = LINED(m->psi);
    double prediction = 0.0;
    long place = (m->head + 1) % taps, lag = taps - 1;
    memset(psi, 0, sizeof(double) * n);
    for (; lag >= 2; lag -= 3) {
        const double *restrict r0 = LINED(m->ring + place * n);
        place = place + 1 < taps ? place + 1 : 0;
        const double *restrict r1 = LINED(m->ring + place * n);
        place = place + 1 < taps ? place + 1 : 0;
        const double *restrict r2 = LINED(m->ring + place * n);
        place = place + 1 < taps ? place + 1 : 0;
        const double a0 = m->a[lag], a1 = m->a[lag - 1], a2 = m->a[lag - 2];
        double g0 = 0.0, g1 = 0.0, g2 = 0.0;
        for (long k = 0; k < n; k++) {
            g0 += r0[k] * w[k];
            g1 += r1[k] * w[k];
            g2 += r2[k] * w[k];
            psi[k] += a0 * r0[k] + a1 * r1[k] + a2 * r2[k];
        }
        m->g[lag] = g0, m->g[lag - 1] = g1, m->g[lag - 2] = g2;
        prediction += a0 * g0 + a1 * g1 + a2 * g2;
    }
    for (; lag >= 0; lag--) {
        const double *restrict r = LINED(m->ring + place * n);
        place = place + 1 < taps ? place + 1 : 0;
        double g = 0.0;
        for (long k = 0; k < n; k++) {
            g += r[k] * w[k];
            psi[k] += m->a[lag] * r[k];
        }
        m->g[lag] = g;
        prediction += m->a[lag] * g;
    }
    place = m->head;
    for (long i = 0; i < m->theory_taps; i++) {
        m->d[i] = m->ring_theory[place];
        prediction += m->b[i] * m->d[i];
        place = place > 0 ? place - 1 : m->theory_taps - 1;
    }
    return prediction;
}

static double normalise(double *a, long taps) {
    double power = 0.0;
    for (long i = 0; i < taps; i++) power += a[i] * a[i];
    const double norm = sqrt(power);
    for (long i = 0; i < taps; i++) a[i] /= norm;
    return norm;
}

/* Running powers of the errors: what is an outlier, and what the model cannot follow. */
typedef struct {
    double power, misfit;
} Errors;

static double clipped(Errors *errors, double e, int moves) {
    const double limit = 6.0 * sqrt(errors->power);
    e = e > limit ? limit : e < -limit ? -limit : e;
    if (moves) {
        errors->power += (e * e - errors->power) / 200.0;
        errors->power = errors->power > 1e-12 ? errors->power : 1e-12;
    }
    return e;
}

/* A* = A + mu e F, A = A* / |A*|, W += mu e A(q) Psi, A1 += mu e F1 */
void lms(long count, long taps, long weights, long theory_taps, long width, const int32_t *restrict index,
         const double *restrict value, const double *restrict theory, const double *restrict target, double step,
         double *restrict theta, double *restrict predicted) {
    Model m = model(taps, weights, theory_taps, width, theta);
    for (long k = 0; k < count; k++) {
        push(&m, index + k * width, value + k * width, theory[k]);
        predicted[k] = regress(&m);
        const double e = step * (target[k] - predicted[k]);
        double *restrict w = LINED(m.w), *restrict psi = LINED(m.psi);
        for (long i = 0; i < taps; i++) m.a[i] += e * m.g[i];
        for (long i = 0; i < m.size; i++) w[i] += e * psi[i];
        for (long i = 0; i < theory_taps; i++) m.b[i] += e * m.d[i];
        normalise(m.a, taps);
    }
    end(&m, theta);
}

/* theta += mu e D x / (eps + x' D x), then the norm of A goes into W where it has left [0.8, 1.25] */
void nlms(long count, long taps, long weights, long theory_taps, long width, const int32_t *restrict index,
          const double *restrict value, const double *restrict theory, const double *restrict target,
          const double *restrict velocity, double least_speed, double step, double floor, const double *restrict metric,
          double *restrict theta, double *restrict predicted) {
    Errors errors = {1.0, 0.0};
    Model m = model(taps, weights, theory_taps, width, theta);
    double *restrict d_w = LINED(room(weights));
    memcpy(d_w, metric + taps, sizeof(double) * weights);
    const double *restrict d_a = metric, *restrict d_b = metric + taps + weights;
    for (long k = 0; k < count; k++) {
        push(&m, index + k * width, value + k * width, theory[k]);
        predicted[k] = regress(&m);
        double *restrict w = LINED(m.w), *restrict psi = LINED(m.psi);
        const double known = clipped(&errors, target[k] - predicted[k], fabs(velocity[k]) > least_speed);
        if (k < taps - 1) continue;
        double energy = floor;
        for (long i = 0; i < taps; i++) energy += d_a[i] * m.g[i] * m.g[i];
        for (long i = 0; i < m.size; i++) energy += d_w[i] * psi[i] * psi[i];
        for (long i = 0; i < theory_taps; i++) energy += d_b[i] * m.d[i] * m.d[i];
        const double e = step * known / energy;
        for (long i = 0; i < taps; i++) m.a[i] += e * d_a[i] * m.g[i];
        for (long i = 0; i < m.size; i++) w[i] += e * d_w[i] * psi[i];
        for (long i = 0; i < theory_taps; i++) m.b[i] += e * d_b[i] * m.d[i];
        double power = 0.0;
        for (long i = 0; i < taps; i++) power += m.a[i] * m.a[i];
        if (power <= 0.64 || power >= 1.5625) {
            const double norm = normalise(m.a, taps);
            for (long i = 0; i < m.size; i++) w[i] *= norm;
        }
    }
    free(d_w);
    end(&m, theta);
}

/* f = S' x, r = f' f; theta += S f e / (noise + r); S -= gamma S f f', gamma = (1 - 1 / sqrt(1 + w r)) / r, where w keeps
 * the leverage at `least` at least. Rows of S where x is zero add nothing to f and are not read. Every 64 samples
 * theta -= S S' R (theta - mean) pull, R the prior's information. */
void rls(long count, long taps, long weights, long theory_taps, long width, const int32_t *restrict index,
         const double *restrict value, const double *restrict theory, const double *restrict target,
         const double *restrict velocity, double least_speed, double least, double residual, const double *restrict mean,
         const double *restrict information, const double *restrict prior_root, double *restrict theta,
         double *restrict predicted) {
    Model m = model(taps, weights, theory_taps, width, theta);
    Errors errors = {1.0, 0.0};
    const long n = taps + weights + theory_taps, size = LINES(n);
    double *restrict root = LINED(room(n * size));
    double *restrict f = LINED(room(n)), *restrict x = LINED(room(n)), *restrict gain = LINED(room(n));
    double absorbed = 0.0, pull = 0.0;
    long unpulled = 0;
    for (long i = 0; i < n; i++) memcpy(root + i * size, prior_root + i * n, sizeof(double) * n);
    for (long k = 0; k < count; k++) {
        push(&m, index + k * width, value + k * width, theory[k]);
        predicted[k] = regress(&m);
        const double e = target[k] - predicted[k];
        memcpy(x, m.g, sizeof(double) * taps);
        memcpy(x + taps, m.psi, sizeof(double) * weights);
        memcpy(x + taps + weights, m.d, sizeof(double) * theory_taps);
        memset(f, 0, sizeof(double) * size);
        for (long i = 0; i < n; i++) {
            if (x[i] == 0.0) continue;
            const double *restrict row = LINED(root + i * size);
            for (long j = 0; j < size; j++) f[j] += x[i] * row[j];
        }
        double r = 0.0;
        for (long j = 0; j < size; j++) r += f[j] * f[j];
        const int moves = fabs(velocity[k]) > least_speed;
        const double known = clipped(&errors, e, moves);
        if (k < taps - 1) continue;
        if (r < 0.1 && moves) errors.misfit += (known * known - errors.misfit) / 5000.0;
        double noise = 10.0 * errors.misfit / residual;
        noise = noise > 1.0 ? noise : 1.0;
        const double step = known / (noise + r);
        double rho = known == e ? noise : e / step - r;
        rho = rho > noise ? rho : noise;
        double w = 1.0 / (least * noise) - 1.0 / r;
        w = w < 0.0 ? 0.0 : w < 1.0 / rho ? w : 1.0 / rho;
        const double gamma = (1.0 - 1.0 / sqrt(1.0 + w * r)) / r;
        for (long i = 0; i < n; i++) {
            double *restrict row = LINED(root + i * size);
            double g = 0.0;
            for (long j = 0; j < size; j++) g += row[j] * f[j];
            gain[i] = g;
            g *= gamma;
            for (long j = 0; j < size; j++) row[j] -= g * f[j];
        }
        add(&m, gain, step);
        absorbed += w * noise;
        pull += (1.0 - w * noise) / (absorbed > 1.0 ? absorbed : 1.0);
        if (++unpulled < 64) continue;
        unpulled = 0;
        const double share = pull < 0.5 ? pull : 0.5;
        pull = 0.0;
        if (share <= 0.0) continue;
        parameters(&m, gain);
        for (long i = 0; i < n; i++) gain[i] = share * (gain[i] - mean[i]);
        memset(f, 0, sizeof(double) * size);
        for (long i = 0; i < n; i++) {
            double force = 0.0;
            for (long j = 0; j < n; j++) force += information[i * n + j] * gain[j];
            for (long j = 0; j < size; j++) f[j] += root[i * size + j] * force;
        }
        for (long i = 0; i < n; i++) {
            double g = 0.0;
            for (long j = 0; j < size; j++) g += root[i * size + j] * f[j];
            x[i] = g;
        }
        add(&m, x, -1.0);
    }
    free(root), free(f), free(x), free(gain);
    end(&m, theta);
}
