/* A driver that crashes, aborts or hangs in the process that draws, while tiles are requested. A
 * real server draws real pictures on any OpenCL device. One launch of a kernel is replaced by one
 * that reads invalid memory or never ends. The linker puts the function below in place of
 * clEnqueueNDRangeKernel (tests/CMakeLists.txt). The process that draws is this program too, and a
 * file tells it what to do.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "core/trace.h"
#include "server/answers/view_stream.h"
#include "tests/server/client.h"

#include <jansson.h>
#include <pthread.h>
#include <signal.h>

static const char POSE[] = "13.398,52.4985,150";
static const char FAULT_ENV[] = "CITYSPLAT_TEST_FAULT";

/* ---- in the process that draws ---- */

static const char fault_source[] =
    "__kernel void wild(__global int *p) { volatile __global int *q = (volatile __global int *)8;"
    " p[0] = q[get_global_id(0)]; }\n"
    "__kernel void ever(volatile __global int *p) { while (p[0] == 0) p[1]++; }\n";

/* A kernel of the fault, in this queue. */
static cl_int fault_launch(cl_command_queue queue, const char *name,
                           cl_int (*launch)(cl_command_queue, cl_kernel, cl_uint, const size_t *,
                                            const size_t *, const size_t *, cl_uint,
                                            const cl_event *, cl_event *))
{
    const char *text = fault_source;
    const size_t one = 1;
    const int zero[16] = {0};
    cl_context context;
    cl_device_id device;
    cl_int code = clGetCommandQueueInfo(queue, CL_QUEUE_CONTEXT, sizeof context, &context, NULL);
    code |= clGetCommandQueueInfo(queue, CL_QUEUE_DEVICE, sizeof device, &device, NULL);
    cl_program program = clCreateProgramWithSource(context, 1, &text, NULL, NULL);
    code |= clBuildProgram(program, 1, &device, "", NULL, NULL);
    cl_kernel kernel = clCreateKernel(program, name, NULL);
    cl_mem mem = clCreateBuffer(context, CL_MEM_READ_WRITE, sizeof zero, NULL, NULL);
    code |= clEnqueueWriteBuffer(queue, mem, CL_TRUE, 0, sizeof zero, zero, 0, NULL, NULL);
    code |= clSetKernelArg(kernel, 0, sizeof mem, &mem);
    return code ? code : launch(queue, kernel, 1, NULL, &one, &one, 0, NULL, NULL);
}

/* NOLINTBEGIN(cert-dcl51-cpp,readability-function-size): as the linker has them */
cl_int __real_clEnqueueNDRangeKernel(cl_command_queue q, cl_kernel k, cl_uint dim,
                                     const size_t *offset, const size_t *global,
                                     const size_t *local, cl_uint n, const cl_event *wait,
                                     cl_event *event);
cl_int __wrap_clEnqueueNDRangeKernel(cl_command_queue q, cl_kernel k, cl_uint dim,
                                     const size_t *offset, const size_t *global,
                                     const size_t *local, cl_uint n, const cl_event *wait,
                                     cl_event *event);
cl_int __wrap_clEnqueueNDRangeKernel(cl_command_queue q, cl_kernel k, cl_uint dim,
                                     const size_t *offset, const size_t *global,
                                     const size_t *local, cl_uint n, const cl_event *wait,
                                     cl_event *event)
{
    char what[16] = "";
    const char *path = getenv(FAULT_ENV);
    FILE *f = path ? fopen(path, "r") : NULL;
    if (f) {
        what[fread(what, 1, sizeof what - 1, f)] = 0;
        fclose(f);
        if (strcmp(what, "always") != 0)
            unlink(path); /* once */
    }
    if (!strcmp(what, "wild") || !strcmp(what, "ever"))
        return fault_launch(q, what, __real_clEnqueueNDRangeKernel);
    if (!strcmp(what, "abort") || !strcmp(what, "always"))
        abort();
    return __real_clEnqueueNDRangeKernel(q, k, dim, offset, global, local, n, wait, event);
}
/* NOLINTEND(cert-dcl51-cpp,readability-function-size) */

/* ---- in this one ---- */

static char fault_path[FILE_PATH_MAX];

static void fault_set(const char *what)
{
    struct err e = {0};
    kit_ok(file_write(fault_path, what, strlen(what), &e), e);
}

static int setup_fault(void **state)
{
    struct err e = {0};
    int rc = setup(state);
    kit_ok(file_join(fault_path, t.dir, "fault", &e), e);
    (void)unlink(fault_path);
    t.cfg.client_views_s = 0;
    t.cfg.requests_per_connection = 1000000;
    return setenv(FAULT_ENV, fault_path, 1) ? 1 : rc;
}

static const char *view_of(int heading, const char *size, char target[256])
{
    snprintf(target, 256, "/d/toy/r/%s/static/%s@%d,-40/%s", revision_of(EDITION_PICTURES), POSE,
             heading, size);
    return target;
}

static struct worker_status drawing(void)
{
    struct worker_status st;
    picture_status(server_services(t.server)->picture, &st);
    return st;
}

/* A picture, as soon as one is made again. Returns how long that took. */
static double await_picture(int heading)
{
    char target[256];
    double start_s = clock_s();
    int status = 0;
    while (status != 200 && clock_s() < start_s + PATIENCE_S) {
        status = status_of("GET", view_of(heading, "96x64.jpg", target), "");
        if (status != 200) {
            assert_int_equal(status, 503);
            nap_ms(5);
        }
    }
    assert_int_equal(status, 200);
    return clock_s() - start_s;
}

static bool readyz_says(const char *text)
{
    struct reply r;
    ask("GET", "/readyz", "", &r);
    assert_int_equal(r.status, 200);
    buf_add(&r.raw, "", 1);
    bool says = strstr((const char *)r.raw.data, text);
    buf_free(&r.raw);
    return says;
}

/* Tiles over one connection that stays open, all the time. */
struct tiles {
    _Atomic bool stop;
    int asked, failed;
    double worst_s;
    char request[400];
};

static void *tiles_ask(void *user)
{
    struct tiles *w = user;
    struct reply r;
    int fd = dial(t.port);
    while (!atomic_load(&w->stop)) {
        double start_s = clock_s();
        say(fd, w->request);
        hear(fd, true, NULL, &r);
        double took_s = clock_s() - start_s;
        w->asked++;
        w->failed += r.status != 200;
        w->worst_s = took_s > w->worst_s ? took_s : w->worst_s;
        buf_free(&r.raw);
        nap_ms(1);
    }
    close(fd);
    return NULL;
}

/* One picture meets the fault. Its asker gets a 503 that says when to come again; all others go on,
 * and pictures are made again by themselves. */
static void survive(const char *what, bool hangs)
{
    struct tiles w = {0};
    struct reply r;
    pthread_t id;
    char target[256];
    if (!start_with_device())
        skip();
    (void)await_picture(0);
    snprintf(w.request, sizeof w.request, "GET %s HTTP/1.1\r\n" H "\r\n",
             tile_target(17, "glb", target));
    assert_int_equal(pthread_create(&id, NULL, tiles_ask, &w), 0);
    pid_t pid = drawing().pid;
    fault_set(what);
    double start_s = clock_s();
    ask("GET", view_of(77, "96x64.jpg", target), "", &r);
    double told_s = clock_s() - start_s;
    assert_int_equal(r.status, 503);
    assert_true(atoi(header(&r, "Retry-After")) >= 1);
    buf_free(&r.raw);
    start_s = clock_s();
    (void)await_picture(78); /* waits for the new process */
    double again_s = clock_s() - start_s;
    assert_true(readyz_says("\"ready\""));
    assert_true(drawing().pid != pid);
    assert_int_equal(drawing().kills, hangs);
    assert_int_equal(drawing().crashes, !hangs);
    (void)await_picture(
        77); /* the one that met the fault is remembered for a while, not for ever */
    atomic_store(&w.stop, true);
    pthread_join(id, NULL);
    print_message("%s: told after %.3f s, the next picture after %.3f s more; %d tiles, "
                  "worst %.1f ms\n",
                  what, told_s, again_s, w.asked, w.worst_s * 1e3);
    assert_true(w.asked > 10);
    assert_int_equal(w.failed, 0);
    assert_int_equal(access(fault_path, F_OK), -1); /* it did happen */
}

static void test_a_kernel_that_reads_wildly(void **state)
{
    survive("wild", false);
}

static void test_a_driver_that_aborts(void **state)
{
    survive("abort", false);
}

static void test_a_kernel_that_never_ends(void **state)
{
    t.cfg.device_timeout_s = 1.5; /* kernels are compiled for the first picture */
    survive("ever", true);
}

/* Every picture crashes: the process is started less and less often, and whoever asks meanwhile is
 * told at once when to come again. */
static void test_a_driver_that_always_crashes(void **state)
{
    struct reply r;
    char target[256];
    bool waited = false;
    if (!start_with_device())
        skip();
    (void)await_picture(0);
    fault_set("always");
    double end_s = clock_s() + 3 * PATIENCE_S;
    for (int i = 1; !waited && clock_s() < end_s; i++) {
        ask("GET", view_of(1 + i % 300, "32x32.jpg", target), "", &r);
        assert_int_equal(r.status, 503);
        assert_true(atoi(header(&r, "Retry-After")) >= 1);
        buf_free(&r.raw);
        waited = drawing().wait_s > 0.3; /* the third time */
        if (!waited) {
            nap_ms(10);
        } else {
            double start_s = clock_s();
            assert_int_equal(status_of("GET", view_of(350, "32x32.jpg", target), ""), 503);
            assert_true(clock_s() - start_s < 0.5);
            assert_true(readyz_says("the process that draws has ended"));
            assert_int_equal(status_of("GET", tile_target(17, "spz", target), ""), 200);
        }
    }
    assert_true(waited);
    assert_true(drawing().crashes >= 3);
    assert_true(drawing().failing_s > 0);
    (void)unlink(fault_path);
    (void)await_picture(0);
}

/* Of two processes that draw, one hangs: its picture alone is lost, and the other one draws
 * meanwhile. */
static void test_one_of_two_hangs(void **state)
{
    char target[256], request[400];
    struct worker_status st;
    struct reply r;
    bool alone = false;
    t.cfg.device_timeout_s = 6;
    t.cfg.drawers = 2;
    t.cfg.memory = "3G";
    if (!start_with_device())
        skip();
    (void)await_picture(0);
    const struct picture *p = server_services(t.server)->picture;
    kit_await(picture_status(p, &st) >= 2);
    fault_set("ever");
    snprintf(request, sizeof request, "GET %s HTTP/1.1\r\n" H "\r\n",
             view_of(1, "64x64.jpg", target));
    int fd = dial(t.port);
    say(fd, request);
    kit_await(access(fault_path, F_OK));
    for (int i = 0; drawing().kills == 0; i++) {
        assert_int_equal(status_of("GET", view_of(2 + i % 300, "64x64.jpg", target), ""), 200);
        alone = alone || drawing().kills == 0;
    }
    hear(fd, true, NULL, &r);
    assert_int_equal(r.status, 503);
    buf_free(&r.raw);
    close(fd);
    assert_true(alone);
    assert_true(drawing().failing_s <= 0); /* one was well all the time */
    assert_true(readyz_says("\"ready\""));
    kit_await(picture_status(p, &st) >= 2);
    assert_int_equal(st.starts, 3);
    assert_int_equal(st.kills, 1);
    (void)await_picture(3);
}

/* Stopping does not wait for a driver that hangs. */
static void test_stopping_while_it_hangs(void **state)
{
    char target[256], request[400];
    struct reply r;
    t.cfg.drain_timeout_s = 0.2;
    if (!start_with_device())
        skip();
    (void)await_picture(0);
    pid_t pid = drawing().pid;
    fault_set("ever");
    snprintf(request, sizeof request, "GET %s HTTP/1.1\r\n" H "\r\n",
             view_of(1, "64x64.jpg", target));
    int fd = dial(t.port);
    say(fd, request);
    kit_await(access(fault_path, F_OK));
    double start_s = clock_s();
    assert_true(server_stop(&t.server));
    assert_true(clock_s() - start_s < 6);
    hear(fd, true, NULL, &r);
    assert_int_equal(r.status, 503);
    buf_free(&r.raw);
    close(fd);
    assert_int_equal(kill(pid, 0), -1); /* it is gone, and waited for */
}

/* A picture that nobody waits for any more is given up while it is made. */
static void test_giving_up(void **state)
{
    char target[256], request[400];
    if (!start_with_device())
        skip();
    (void)await_picture(0);
    struct services *s = server_services(t.server);
    struct job_stats st;
    for (int i = 1; i < 100 && drawing().cancels == 0; i++) {
        snprintf(request, sizeof request, "GET %s HTTP/1.1\r\n" H "\r\n",
                 view_of(i, "2000x1900.png", target));
        int fd = dial(t.port);
        say(fd, request);
        for (double end_s = clock_s() + PATIENCE_S; clock_s() < end_s;) {
            job_count(s->jobs, &st);
            if (st.running[JOB_VIEW])
                break;
        }
        close(fd);
        kit_await(job_idle(s->jobs));
    }
    assert_true(drawing().cancels >= 1);
    assert_int_equal(drawing().starts, 1);
    (void)await_picture(1);
}

struct seen { /* a span, in seconds */
    double from_s, to_s;
};

/* The first span of this name on this track that begins at after_s or later. */
static struct seen traced(const json_t *trace, const char *track, const char *name, double after_s)
{
    struct seen out = {-1, -1};
    json_int_t id = -1, number = -1;
    size_t i;
    const json_t *ev;
    json_array_foreach(json_object_get(trace, "traceEvents"), i, ev)
    {
        const char *ph = json_string_value(json_object_get(ev, "ph")),
                   *said = json_string_value(json_object_get(ev, "name")),
                   *of = json_string_value(json_object_get(json_object_get(ev, "args"), "name"));
        const json_int_t tid = json_integer_value(json_object_get(ev, "tid")),
                         pair = json_integer_value(json_object_get(ev, "id"));
        const double at_s = 1e-6 * json_number_value(json_object_get(ev, "ts"));
        if (!strcmp(ph, "M") && of && !strcmp(of, track))
            id = tid;
        if (tid != id || strcmp(said, name) != 0)
            continue;
        if (out.from_s < 0 && at_s >= after_s && strcmp(ph, "e") != 0) {
            out.from_s = at_s;
            out.to_s = at_s + 1e-6 * json_number_value(json_object_get(ev, "dur"));
            number = !strcmp(ph, "b") ? pair : -1;
        } else if (!strcmp(ph, "e") && pair == number) {
            out.to_s = at_s;
        }
    }
    if (out.from_s < 0)
        fail_msg("no %s on %s", name, track);
    return out;
}

/* serve --trace: a request, its wait, and what both processes did for it, one within the other. */
static void test_a_picture_is_traced(void **state)
{
    static const char VIEW_ROUTE[] = "/d/{ds}/r/{rev}/static/{lon},{lat},{height}@{heading},"
                                     "{pitch}[,{fov}[,{roll}]]/{w}x{h}[@{s}x].{fmt}";
    static const char *const stages[] = {"pick tiles", "load tiles", "draw", "encode"};
    char path[FILE_PATH_MAX], target[256];
    struct trace_result r;
    struct err e = {0};
    const double round_s = 1e-6; /* times are written in tenths of microseconds */
    t.cfg.workers = 1;           /* one thread for tiles */
    if (!start_with_device())
        skip();
    (void)await_picture(0);
    kit_ok(file_join(path, t.dir, "trace.json", &e), e);
    kit_ok(trace_begin(path, &e), e);
    assert_int_equal(status_of("GET", view_of(77, "96x64.jpg", target), ""), 200);
    assert_int_equal(status_of("GET", tile_target(17, "spz", target), ""), 200);
    nap_ms(50); /* a request ends after its answer */
    kit_ok(trace_end(&r, &e), e);
    assert_int_equal(r.dropped, 0);
    json_t *j = json_load_file(path, 0, NULL);
    assert_non_null(j);
    const struct seen asked = traced(j, "requests", VIEW_ROUTE, 0),
                      waits = traced(j, "queue", "picture", asked.from_s),
                      made = traced(j, "pictures", "picture", waits.to_s - round_s);
    assert_true(made.to_s <= asked.to_s + round_s);
    double last_s = made.from_s;
    for (size_t i = 0; i < sizeof stages / sizeof *stages; i++) {
        const struct seen stage = traced(j, "drawing", stages[i], last_s - round_s);
        assert_true(stage.to_s <= made.to_s + round_s);
        last_s = stage.to_s;
    }
    /* The tile was asked for after the picture's answer, but maybe before that request was over. */
    (void)traced(j, "tiles 1", "tile", traced(j, "queue", "tile", made.to_s).to_s - round_s);
    json_decref(j);
}

#define FAULT_TEST(f) cmocka_unit_test_setup_teardown(f, setup_fault, teardown)

int main(int argc, char **argv)
{
    if (worker_asked(argc, argv))
        return draw_main();
    const struct CMUnitTest tests[] = {
        FAULT_TEST(test_a_kernel_that_reads_wildly),
        FAULT_TEST(test_a_driver_that_aborts),
        FAULT_TEST(test_a_kernel_that_never_ends),
        FAULT_TEST(test_a_driver_that_always_crashes),
        FAULT_TEST(test_one_of_two_hangs),
        FAULT_TEST(test_stopping_while_it_hangs),
        FAULT_TEST(test_giving_up),
        FAULT_TEST(test_a_picture_is_traced),
    };
    return cmocka_run_group_tests(tests, setup_all, teardown_all);
}
