/* Georeferencing against known frames: noise, outliers, two flights, wrong poses, straight lines;
 * many seeds.
 *
 * A survey of cameras is made in ENU (nadir strips and four oblique passes). The code gets it in a
 * frame with a random rotation, scale and shift. The result is compared with the survey.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <math.h>
#include <string.h>

#include "core/splat/camera.h"
#include "scene/control/georef.h"
#include "tests/kit.h"

enum { SEEDS = 40, N_MAX = 400 };
static const double sigma_m = 3;

struct survey {
    struct georef_photo photos[N_MAX];
    bool outlier[N_MAX];
    size_t n;
    struct sim3 truth;
    double center_enu_m[3]; /* mean of the cameras */
};

static struct georef_config config(void)
{
    return (struct georef_config){.inlier_m = 8, .seed = 1};
}

static void random_frame(uint64_t seed, struct sim3 *s)
{
    double q[4];
    for (uint64_t k = 0; k < 4; k++)
        q[k] = rng_normal(seed, 100, k);
    camera_quat_to_rot(q, s->rot);
    s->scale = exp2(8 * rng_unit(seed, 101, 0) - 4);
    for (uint64_t k = 0; k < 3; k++)
        s->trans[k] = 500 * rng_normal(seed, 102, k);
}

/* Put an ENU camera into photo i, in COLMAP's frame. */
static void put_camera(struct survey *s, size_t i, const struct camera *cam)
{
    struct georef_photo *p = &s->photos[i];
    double c[3], d[3];
    const struct sim3 *t = &s->truth;
    camera_center(cam, c);
    for (int a = 0; a < 3; a++)
        d[a] = (c[a] - t->trans[a]) / t->scale;
    *p = (struct georef_photo){.has_gps = true};
    memcpy(p->gps_enu_m, c, sizeof c);
    for (int a = 0; a < 3; a++) {
        p->center[a] = t->rot[a] * d[0] + t->rot[3 + a] * d[1] + t->rot[6 + a] * d[2];
        s->center_enu_m[a] += c[a] / (double)s->n;
        for (int b = 0; b < 3; b++)
            p->rot[3 * a + b] = cam->rot[3 * a] * t->rot[b] + cam->rot[3 * a + 1] * t->rot[3 + b] +
                                cam->rot[3 * a + 2] * t->rot[6 + b];
    }
}

/* Half nadir strips, half oblique in four directions, over a square of `edge` metres. */
static void make_survey(uint64_t seed, size_t n, double edge, struct survey *s)
{
    *s = (struct survey){.n = n};
    random_frame(seed, &s->truth);
    size_t side = (size_t)ceil(sqrt((double)n / 2));
    for (size_t i = 0; i < n; i++) {
        size_t k = i % (n / 2);
        double eye[3] = {edge * ((double)(k % side) / (double)(side - 1) - 0.5),
                         edge * ((double)(k / side) / (double)(side - 1) - 0.5),
                         80 + rng_normal(seed, 1, i)};
        bool nadir = i < n / 2;
        double heading = nadir ? (k / side % 2 ? 180 : 0) : 90.0 * (double)(k % 4);
        struct camera cam =
            camera_heading(eye, heading + 5 * rng_normal(seed, 2, i),
                           (nadir ? -90 : -45) + 2 * rng_normal(seed, 3, i), 0.8, 400, 300);
        put_camera(s, i, &cam);
    }
}

static void add_noise(uint64_t seed, double sigma, struct survey *s)
{
    for (size_t i = 0; i < s->n; i++)
        for (uint64_t a = 0; a < 3; a++)
            s->photos[i].gps_enu_m[a] += sigma * rng_normal(seed, 10 + a, i);
}

/* Every 20th position is 45 to 445 m off. */
static void add_outliers(uint64_t seed, struct survey *s)
{
    for (size_t i = seed % 20; i < s->n; i += 20) {
        double d[3], len = 0, far = 45 + 400 * rng_unit(seed, 20, i);
        for (uint64_t a = 0; a < 3; a++) {
            d[a] = rng_normal(seed, 21 + a, i);
            len += d[a] * d[a];
        }
        for (int a = 0; a < 3; a++)
            s->photos[i].gps_enu_m[a] += far * d[a] / sqrt(len);
        s->outlier[i] = true;
    }
}

/* Where the fit puts the middle of the cameras, minus where it is. */
static void center_error(const struct survey *s, const struct sim3 *got, double out[3])
{
    double d[3], x[3];
    const struct sim3 *t = &s->truth;
    for (int a = 0; a < 3; a++)
        d[a] = (s->center_enu_m[a] - t->trans[a]) / t->scale;
    for (int a = 0; a < 3; a++)
        x[a] = t->rot[a] * d[0] + t->rot[3 + a] * d[1] + t->rot[6 + a] * d[2];
    sim3_apply(got, x, out);
    for (int a = 0; a < 3; a++)
        out[a] -= s->center_enu_m[a];
}

static double rotation_error(const double a[9], const double b[9])
{
    double trace = 0;
    for (int i = 0; i < 9; i++)
        trace += a[i] * b[i];
    return acos(fmin(1, fmax(-1, 0.5 * (trace - 1))));
}

static void count_drops(const struct survey *s, const struct georef_result *r, size_t *missed,
                        size_t *good)
{
    *missed = *good = 0;
    for (size_t i = 0; i < s->n; i++) {
        *missed += s->outlier[i] && !r->dropped[i];
        *good += !s->outlier[i] && r->dropped[i];
    }
}

static void test_exact(void **state)
{
    struct survey s;
    struct err e = {0};
    for (uint64_t seed = 0; seed < 10; seed++) {
        struct georef_result r;
        struct georef_config cfg = config();
        double off[3];
        make_survey(seed, 40, 150, &s);
        kit_ok(georef_fit(s.photos, s.n, &cfg, &r, &e), e);
        center_error(&s, &r.sim, off);
        kit_near_d("centre", off, (const double[3]){0, 0, 0}, 3, 1e-4,
                   0); /* level prior: 1e-2 m / 1e-2 rad */
        assert_true(fabs(r.sim.scale / s.truth.scale - 1) < 1e-6);
        assert_true(rotation_error(r.sim.rot, s.truth.rot) < 1e-5);
        assert_int_equal(r.n_dropped, 0);
        assert_int_equal(r.n_flights, 1);
        assert_false(r.collinear);
        georef_free(&r);
    }
}

/* Gaussian noise of 3 m an axis and 5 % gross outliers. The error of a mean of N positions has the
 * standard deviation sigma / sqrt(N): of 120 draws at most 2 may be beyond three of them (0.3
 * expected), and their root mean square must show that no information is lost. */
static void test_noise_and_outliers(void **state)
{
    static const size_t counts[] = {60, 120, 200};
    struct survey s;
    struct err e = {0};
    for (size_t c = 0; c < 3; c++) {
        size_t beyond = 0;
        double sum2 = 0, unit = sigma_m / sqrt((double)counts[c] * 0.95);
        for (uint64_t seed = 0; seed < SEEDS; seed++) {
            struct georef_result r;
            struct georef_config cfg = config();
            double off[3];
            size_t missed, good;
            make_survey(seed, counts[c], 300, &s);
            add_noise(seed, sigma_m, &s);
            add_outliers(seed, &s);
            kit_ok(georef_fit(s.photos, s.n, &cfg, &r, &e), e);
            center_error(&s, &r.sim, off);
            for (int a = 0; a < 3; a++) {
                beyond += fabs(off[a]) > 3 * unit;
                sum2 += off[a] * off[a];
            }
            if (fabs(r.sim.scale / s.truth.scale - 1) > 0.01)
                fail_msg("seed %zu, %zu photos: scale off by %.3f %%", (size_t)seed, s.n,
                         100 * (r.sim.scale / s.truth.scale - 1));
            count_drops(&s, &r, &missed, &good);
            if (missed || (double)good > 0.02 * (double)s.n || r.n_flights != 1)
                fail_msg("seed %zu, %zu photos: %zu outliers kept, %zu good ones dropped, %zu "
                         "flights, tau %.1f m",
                         (size_t)seed, s.n, missed, good, r.n_flights, r.tau_m);
            /* A median of 57 distances is good to 13 %: 3.5 of that. */
            if (!(r.fit.sigma_h_m > 0.55 * sigma_m && r.fit.sigma_h_m < 1.45 * sigma_m))
                fail_msg("seed %zu, %zu photos: noise judged %.2f m", (size_t)seed, s.n,
                         r.fit.sigma_h_m);
            georef_free(&r);
        }
        double rms = sqrt(sum2 / (3 * SEEDS)) / unit;
        print_message("%zu photos: rms error %.2f sigma/sqrt(N), %zu of %d beyond 3\n", counts[c],
                      rms, beyond, 3 * SEEDS);
        assert_true(rms <
                    1.2); /* 1 when nothing is lost; 120 draws tell it to 6.5 %, three of that */
        assert_true(beyond <= 2);
    }
}

/* Heights of the second half 12 m (and more) higher; flights known by time, or not. */
static void test_two_flights(void **state)
{
    static const double offsets[] = {12, -12, 35, 90};
    struct survey s;
    struct err e = {0};
    size_t most = 0;
    for (uint64_t seed = 0; seed < SEEDS; seed++)
        for (int how = 0; how < 3; how++) {
            struct georef_result r;
            struct georef_config cfg = config();
            double off[3], scatter = seed % 2 ? 3 : 0.5, offset = offsets[seed % 4];
            size_t rejected = 0;
            make_survey(seed, 120, 200, &s);
            add_noise(seed, scatter, &s);
            for (size_t i = 0; i < s.n; i++) {
                /* how 0: second half, told by a pause; 1: second half, untold; 2: every third,
                 * untold */
                bool second = how == 2 ? i % 3 == 0 : i >= 70;
                s.photos[i].flight_hint = how == 0 && second;
                s.photos[i].gps_enu_m[2] += second ? offset : 0;
            }
            kit_ok(georef_fit(s.photos, s.n, &cfg, &r, &e), e);
            for (size_t i = 0; i < s.n; i++)
                rejected += r.dropped[i];
            center_error(&s, &r.sim, off);
            double low = fabs(r.flight_offset_m[1] - offset);
            if (rejected > 2 || r.n_flights != 2 || low > 3 * scatter ||
                hypot(off[0], off[1]) > scatter)
                fail_msg("seed %zu, how %d, offset %g: %zu rejected, %zu flights, offset %.2f, "
                         "centre off %.2f %.2f %.2f",
                         (size_t)seed, how, offset, rejected, r.n_flights, r.flight_offset_m[1],
                         off[0], off[1], off[2]);
            most = rejected > most ? rejected : most;
            georef_free(&r);
        }
    kit_figure("F19", "offsets_m=12..90 worst_rejected_percent=%.2f limit=2.00",
               100.0 * (double)most / 120.0);
}

/* A receiver whose height drifts by 110 m while the drone flies level: the scene must not tilt for
 * it, at most 5 % are dropped, and no second flight is invented. */
static void test_drifting_heights(void **state)
{
    struct survey s;
    struct err e = {0};
    for (uint64_t seed = 0; seed < SEEDS; seed++) {
        struct georef_result r;
        struct georef_config cfg = config();
        make_survey(seed, 80, 150, &s);
        add_noise(seed, 2, &s);
        for (size_t i = 0; i < s.n; i++)
            s.photos[i].gps_enu_m[2] += 110 * (1 - exp(-2.5 * (double)i / (double)s.n));
        if (seed % 2) /* the ground's normal, in COLMAP's frame, a few degrees off */
            for (int a = 0; a < 3; a++)
                cfg.ground_normal[a] = s.truth.rot[6 + a] + 0.04 * s.truth.rot[a];
        kit_ok(georef_fit(s.photos, s.n, &cfg, &r, &e), e);
        double turned = rotation_error(r.sim.rot, s.truth.rot) * 180 / M_PI;
        double stretched = fabs(r.sim.scale / s.truth.scale - 1);
        if (turned > 4 || stretched > 0.05 || r.n_dropped > 4 || r.n_flights > 1)
            fail_msg(
                "seed %zu: turned by %.1f degrees, scale off by %.1f %%, %zu dropped, %zu flights",
                (size_t)seed, turned, 100 * stretched, r.n_dropped, r.n_flights);
        assert_true(r.fit.share_v < 0.2); /* and it knows */
        georef_free(&r);
    }
}

/* A camera 15 m from where it says, good GPS: flagged, and nothing else. */
static void test_pose_errors(void **state)
{
    struct survey s;
    struct err e = {0};
    for (uint64_t seed = 0; seed < SEEDS; seed++) {
        struct georef_result r;
        struct georef_config cfg = config();
        size_t missed, good;
        make_survey(seed, 100, 200, &s);
        add_noise(seed, 0.5 + 0.5 * (double)(seed % 3), &s);
        for (size_t i = seed % 50; i < s.n; i += 50) { /* 2 % */
            double d[3], len = 0;
            for (uint64_t a = 0; a < 3; a++) {
                d[a] = rng_normal(seed, 30 + a, i);
                len += d[a] * d[a];
            }
            for (int a = 0; a < 3; a++)
                s.photos[i].center[a] += 15 / s.truth.scale * d[a] / sqrt(len);
            s.outlier[i] = true;
        }
        kit_ok(georef_fit(s.photos, s.n, &cfg, &r, &e), e);
        count_drops(&s, &r, &missed, &good);
        if (missed || good)
            fail_msg("seed %zu: %zu wrong poses kept, %zu good ones dropped, tau %.1f m",
                     (size_t)seed, missed, good, r.tau_m);
        georef_free(&r);
    }
}

/* One straight line, looking down or aslant: the roll comes from the cameras. */
static void test_collinear(void **state)
{
    struct survey s;
    struct err e = {0};
    for (uint64_t seed = 0; seed < SEEDS; seed++) {
        struct georef_result r;
        struct georef_config cfg = config();
        double azimuth = 360 * rng_unit(seed, 40, 0), pitch = seed % 2 ? -90 : -60, off[3];
        s = (struct survey){.n = 50};
        random_frame(seed, &s.truth);
        for (size_t i = 0; i < s.n; i++) {
            double along = 8 * ((double)i - 24.5), h = azimuth * M_PI / 180;
            double eye[3] = {along * sin(h), along * cos(h), 90};
            struct camera cam = camera_heading(eye, azimuth + 2 * rng_normal(seed, 41, i),
                                               pitch + 2 * rng_normal(seed, 42, i), 0.8, 400, 300);
            put_camera(&s, i, &cam);
        }
        add_noise(seed, seed % 3 ? 1 : 0, &s);
        kit_ok(georef_fit(s.photos, s.n, &cfg, &r, &e), e);
        assert_true(r.collinear);
        center_error(&s, &r.sim, off);
        if (!(fabs(off[0]) < 1 && fabs(off[1]) < 1 && fabs(off[2]) < 1))
            fail_msg("seed %zu: centre off %.2f %.2f %.2f m, scale %g, sigma %g", (size_t)seed,
                     off[0], off[1], off[2], r.sim.scale / s.truth.scale, r.fit.sigma_h_m);
        assert_true(fabs(r.sim.scale / s.truth.scale - 1) < 0.01);
        double turned = rotation_error(r.sim.rot, s.truth.rot) * 180 / M_PI;
        if (turned > 2) /* degrees: 2 degrees of pitch and heading jitter, averaged */
            fail_msg("seed %zu: turned by %.2f degrees", (size_t)seed, turned);
        georef_free(&r);
    }
}

/* A line flown with the pictures' x axes along it, from whose being level no roll about it follows:
 * gimbals tell it. */
static void test_collinear_sideways(void **state)
{
    static struct survey s;
    struct err e = {0};
    double worst[2] = {0};
    for (uint64_t seed = 0; seed < SEEDS; seed++) {
        double azimuth = 360 * rng_unit(seed, 40, 0), up[3] = {0};
        s = (struct survey){.n = 50};
        random_frame(seed, &s.truth);
        for (size_t i = 0; i < s.n; i++) {
            double along = 8 * ((double)i - 24.5), h = azimuth * M_PI / 180;
            double eye[3] = {along * sin(h), along * cos(h), 90};
            struct camera cam =
                camera_heading(eye, azimuth + 90 + 2 * rng_normal(seed, 41, i), -75, 0.8, 400, 300);
            put_camera(&s, i, &cam);
            double *r = s.photos[i].rot, roll = 0.02 * rng_normal(seed, 44, i);
            for (int k = 0; k < 3; k++) {
                double right = r[k], down = r[3 + k];
                r[k] = cos(roll) * right + sin(roll) * down;
                r[3 + k] = cos(roll) * down - sin(roll) * right;
            }
        }
        add_noise(seed, 1, &s);
        for (int k = 0; k < 3; k++) /* as ingest_drone_up finds it, half a degree off */
            up[k] = s.truth.rot[6 + k] + 0.005 * rng_normal(seed, 43, (uint64_t)k);
        double len = sqrt(up[0] * up[0] + up[1] * up[1] + up[2] * up[2]);
        for (int gimbal = 0; gimbal < 2; gimbal++) {
            struct georef_result r;
            struct georef_config cfg = config();
            for (int k = 0; gimbal && k < 3; k++)
                cfg.ground_normal[k] = up[k] / len;
            cfg.normal_sigma = gimbal ? 0.02 : 0;
            kit_ok(georef_fit(s.photos, s.n, &cfg, &r, &e), e);
            assert_true(r.collinear);
            worst[gimbal] =
                fmax(worst[gimbal], rotation_error(r.sim.rot, s.truth.rot) * 180 / M_PI);
            georef_free(&r);
        }
    }
    print_message("sideways line: turned by up to %.1f deg, with gimbals %.2f\n", worst[0],
                  worst[1]);
    assert_true(worst[1] < 1 && worst[0] > 4);
}

static void test_upright_without_gps(void **state)
{
    struct survey s;
    struct err e = {0};
    for (uint64_t seed = 0; seed < 20; seed++) {
        struct sim3 sim;
        const double none[3] = {0};
        make_survey(seed, 40, 150, &s);
        kit_ok(georef_upright(s.photos, s.n, none, 0, 2, &sim, &e), e);
        /* COLMAP's image of ENU up must come out as up. */
        double up[3];
        for (int i = 0; i < 3; i++)
            up[i] = sim.rot[3 * i] * s.truth.rot[6] + sim.rot[3 * i + 1] * s.truth.rot[7] +
                    sim.rot[3 * i + 2] * s.truth.rot[8];
        assert_true(up[2] > cos(2 * M_PI / 180));
        assert_true(sim.scale == 2);
    }
}

/* Cameras on a string hang askew, all to the same side and each a little otherwise. */
static void test_upright_under_a_kite(void **state)
{
    struct survey s;
    struct err e = {0};
    double worst = 0;
    for (uint64_t seed = 0; seed < 20; seed++) {
        struct sim3 sim;
        double normal[3], up = 0;
        make_survey(seed, 40, 150, &s);
        for (size_t i = 0; i < s.n; i++) {
            double lean = (18 + 9 * rng_normal(seed, 30, i)) * M_PI / 180, *rot = s.photos[i].rot;
            for (int a = 0; a < 3; a++) {
                double right = rot[a], ahead = rot[6 + a];
                rot[a] = cos(lean) * right + sin(lean) * ahead;
                rot[6 + a] = cos(lean) * ahead - sin(lean) * right;
            }
        }
        for (int a = 0; a < 3; a++)
            normal[a] = (seed % 2 ? -1 : 1) * s.truth.rot[6 + a];
        kit_ok(georef_upright(s.photos, s.n, normal, 0, 2, &sim, &e), e);
        for (int a = 0; a < 3; a++)
            up += sim.rot[6 + a] * s.truth.rot[6 + a];
        worst = fmax(worst, acos(fmin(up, 1)) * 180 / M_PI);
    }
    kit_figure("georef", "kite_tilt_deg=%.2f limit=3", worst);
    assert_true(worst < 3);
}

static void test_refused(void **state)
{
    struct survey s;
    struct err e = {0};
    struct georef_result r;
    struct georef_config cfg = config();
    make_survey(1, 40, 150, &s);
    for (size_t i = 2; i < s.n; i++)
        s.photos[i].has_gps = false;
    kit_fails(georef_fit(s.photos, s.n, &cfg, &r, &e), ERR_DATA, e, "2 photographs have a GPS");
    assert_null(r.residual_m);
    make_survey(1, 40, 150, &s);
    for (size_t i = 0; i < s.n; i++)
        memset(s.photos[i].gps_enu_m, 0, sizeof s.photos[i].gps_enu_m);
    kit_fails(georef_fit(s.photos, s.n, &cfg, &r, &e), ERR_DATA, e, "one place");
    kit_fails(georef_fit(s.photos, 0, &cfg, &r, &e), ERR_DATA, e, "three at least");
    /* Some without GPS: they take part in nothing and have no residual. */
    make_survey(1, 40, 150, &s);
    for (size_t i = 0; i < s.n; i += 3)
        s.photos[i].has_gps = false;
    kit_ok(georef_fit(s.photos, s.n, &cfg, &r, &e), e);
    assert_true(isnan(r.residual_m[0]) && r.residual_m[1] < 0.1 && !r.dropped[0]);
    georef_free(&r);
}

static void test_out_of_memory(void **state)
{
    struct survey s;
    struct err e = {0};
    struct georef_result r;
    struct georef_config cfg = config();
    make_survey(1, 30, 150, &s);
    kit_out_of_memory(georef_fit(s.photos, s.n, &cfg, &r, &e), 1, e);
    georef_free(&r);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_exact),
        cmocka_unit_test(test_noise_and_outliers),
        cmocka_unit_test(test_two_flights),
        cmocka_unit_test(test_pose_errors),
        cmocka_unit_test(test_drifting_heights),
        cmocka_unit_test(test_collinear),
        cmocka_unit_test(test_collinear_sideways),
        cmocka_unit_test(test_upright_without_gps),
        cmocka_unit_test(test_upright_under_a_kite),
        cmocka_unit_test(test_refused),
        cmocka_unit_test(test_out_of_memory),
    };
    return cmocka_run_group_tests_name("georef", tests, NULL, NULL);
}
