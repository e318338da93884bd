// Start of the image when it is built without the Arduino core, which has a main() of its own.
extern void setup();
extern void loop();

int main() {
  setup();
  for (;;) loop();
}
