// Every text of the page, in one table.

const TABLE = {
  en: {
    title: 'Kestrel console', login: 'Log in', logout: 'Log out', user: 'User', password: 'Password', enter: 'Enter',
    login_why: 'This page flies a real machine. Everything is written down with your name.',
    setup: 'First user', setup_why: 'Nobody has a password yet. Make the first administrator.', code: 'Code on the terminal', create: 'Create',
    fly: 'Fly', mission: 'Mission', charts: 'Charts', parameters: 'Parameters', log: 'Log', people: 'People', health: 'Health',
    connecting: 'Connecting …', lost: 'No connection to the drone: it holds or lands by itself', over: 'Your session is over: log in again',
    no_state: 'Waiting for the drone …', armed: 'Armed', disarmed: 'Disarmed', ready: 'Ready to fly', flying: 'Flying', landing: 'Landing', taking_off: 'Taking off',
    control: 'Control', take: 'Take control', release: 'Release', you: 'You have control', nobody: 'Nobody has control', other: '{who} has control',
    station: 'Station {n}', ask: 'Ask for control', asked: 'Asked: waiting for an answer', asks: '{who} asks for control', hand: 'Hand over', keep: 'Keep', viewer: 'You may watch and stop',
    slide_arm: 'Slide to arm', not_ready: 'Not ready', disarm: 'Disarm', takeoff: 'Take off', land: 'Land', return: 'Return', hold: 'Hold', patrol: 'Patrol', stop: 'STOP', stop_again: 'again: LAND',
    sticks: 'Sticks', auto: 'Automatic', manual: 'Manual',
    m_Hold: 'Hold', m_Mission: 'Mission', m_Return: 'Return', m_Land: 'Land', m_Takeoff: 'Take-off', m_Offboard: 'Off-board', m_Position: 'Position', m_Altitude: 'Height', m_Stabilized: 'Stabilized',
    d_Position: 'Sticks are speeds; it keeps clear of walls and people', d_Altitude: 'Sticks tilt; the height is held', d_Stabilized: 'Sticks tilt; thrust is yours',
    blocked: 'Not ready: {why}', battery: 'Battery', link: 'Link', latency: 'Latency', position: 'Position', height: 'Height', speed: 'Speed', heading: 'Heading',
    loc_0: 'off', loc_1: 'searching', loc_2: 'sure', loc_3: 'lost', localization: 'Place', fc: 'Flight controller', rangers: 'Range finders', loop: 'Flight loop', fit: 'fit {n} %', missed: '{n} beats missed', ok: 'fine', silent: 'silent', speaking: 'speaking',
    video: 'Camera', no_video: 'No camera', no_video_why: 'This drone was started without one (--camera). The plan shows what it sees by its range finders.', video_connecting: 'Connecting to the camera …', video_stale: 'The picture is old', video_large: 'Large picture (V)', video_record: 'Record the picture', no_recording: 'There is no picture to record',
    goto: 'Fly there', goto_wall: 'There is no free floor', need_control: 'Take control first', need_flight: 'Take off first', layers: 'Layers', fit_view: 'Whole plan', follow: 'Follow', zoom_in: 'Closer', zoom_out: 'Farther',
    l_cones: 'Range finders', l_particles: 'Particles', l_histogram: 'Directions', l_path: 'Path flown', l_names: 'Rooms', l_fence: 'Fence',
    no_pad: 'Plug in a gamepad or transmitter and press a button', pad: 'Pad', preset: 'Mapping', use_pad: 'Fly by sticks', pad_on: 'Sticks are live', throttle_first: 'Centre the throttle stick first', pad_lost: 'The pad was unplugged: sticks centred', pad_frozen: 'The pad has frozen: sticks centred', unfocused: 'Sticks rest while this page is not in front',
    expo: 'Expo', dead_zone: 'Dead zone', axis_x: 'Forward', axis_y: 'Right', axis_z: 'Up', axis_r: 'Turn',
    edit: 'Edit', done: 'Done', all_rooms: 'Visit every room', clear: 'Clear', upload: 'Send to drone', download: 'Read from drone', start: 'Start', waypoint: 'Point {n}', seconds: '{n} s', sent: 'The mission is on board', not_sent: 'The mission was refused: {why}', mission_hint: 'Click on the plan to add points; drag to move them.', wait: 'Stay', remove: 'Remove', then_home: 'Return home and land at the end', mission_state: 'Point {n} of {m}', empty: 'No points yet',
    search: 'Search', changed: 'set', value: 'Value', default: 'default {v}', loading: '{n} of {m}', refused_param: 'not taken',
    messages: 'Messages', logins: 'Log-ins', intrusions: 'Intrusions', actions: 'Actions', time: 'Time', what: 'What', from: 'From', nothing: 'Nothing yet', files: 'Files', save: 'Save',
    role: 'Role', add_user: 'Add user', viewer_role: 'viewer', new_password: 'New password (10 characters or more)', name: 'Name', sure_remove: 'Remove {who}?',
    light: 'Light', dark: 'Dark', language: 'Language', freeze: 'Freeze', c_height: 'Height, m', c_speed: 'Speed, m/s', c_tilt: 'Tilt, °', c_battery: 'Battery, V', c_sigma: 'Position 1σ, m', c_link: 'Latency, ms', c_roll: 'roll', c_pitch: 'pitch', c_x: 'x', c_y: 'y', c_z: 'up',
    v_1: 'A message was broken', v_2: 'A message came out of order', v_3: 'Too late: not carried out', v_4: 'Another has control', v_5: 'Your role may not do that', v_6: 'Wrong station number',
    avoid: 'Avoid', avoid_why: 'Fly round obstacles (VFH_ENABLE)', evade: 'Give way', evade_why: 'Step aside for people (AVOID_EVADE)', search_place: 'Find place', search_place_why: 'Take off and look round when the place is not known (LOC_SEARCH)',
    live: 'Live', replay: 'Replay', play: 'Play', save_recording: 'Save this recording', open_recording: 'Open a recording', not_a_recording: 'This is not a recording of this console', replay_click: 'This is a replay: go back to live to fly',
    keys: 'Esc stops · T takes off · L lands · 0 whole plan', failed: '{what}: {why}', ago: '{n} s ago', percent: '{n} %',
    vehicles: 'Vehicles', open: 'Open', reachable: 'Reachable', not_yours: 'Not assigned to you', no_vehicles: 'No vehicle is assigned to you: ask an administrator.', no_vehicles_admin: 'No vehicle yet: add the first one.',
    add_vehicle: 'Add vehicle', vehicle_url: 'Address with its key', vehicle_name: 'Name here (or what it calls itself)', vehicle_url_why: '“kestrel passwd --key NAME” on the drone prints it; a simulator’s link does as well.', assigned_to: 'Assigned to', assign: 'Assign to {who}', take_away: 'Take away from {who}',
    look_again: 'Replay', looking: 'The drone flies the log again …',
  },
  es: {
    title: 'Consola Kestrel', login: 'Entrar', logout: 'Salir', user: 'Usuario', password: 'Contraseña', enter: 'Entrar',
    login_why: 'Esta página pilota una máquina real. Todo queda registrado con su nombre.',
    setup: 'Primer usuario', setup_why: 'Nadie tiene contraseña todavía. Cree el primer administrador.', code: 'Código del terminal', create: 'Crear',
    fly: 'Volar', mission: 'Misión', charts: 'Gráficas', parameters: 'Parámetros', log: 'Registro', people: 'Personas', health: 'Estado',
    connecting: 'Conectando …', lost: 'Sin conexión con el dron: se mantiene o aterriza solo', over: 'Su sesión ha terminado: entre de nuevo',
    no_state: 'Esperando al dron …', armed: 'Armado', disarmed: 'Desarmado', ready: 'Listo para volar', flying: 'En vuelo', landing: 'Aterrizando', taking_off: 'Despegando',
    control: 'Control', take: 'Tomar el control', release: 'Ceder', you: 'Usted tiene el control', nobody: 'Nadie tiene el control', other: '{who} tiene el control',
    station: 'Estación {n}', ask: 'Pedir el control', asked: 'Pedido: esperando respuesta', asks: '{who} pide el control', hand: 'Ceder', keep: 'Conservar', viewer: 'Puede mirar y parar',
    slide_arm: 'Deslice para armar', not_ready: 'No está listo', disarm: 'Desarmar', takeoff: 'Despegar', land: 'Aterrizar', return: 'Volver', hold: 'Mantener', patrol: 'Patrullar', stop: 'PARAR', stop_again: 'otra vez: ATERRIZA',
    sticks: 'Mandos', auto: 'Automático', manual: 'Manual',
    m_Hold: 'Mantener', m_Mission: 'Misión', m_Return: 'Volver', m_Land: 'Aterrizar', m_Takeoff: 'Despegue', m_Offboard: 'Externo', m_Position: 'Posición', m_Altitude: 'Altura', m_Stabilized: 'Estabilizado',
    d_Position: 'Los mandos son velocidades; evita paredes y personas', d_Altitude: 'Los mandos inclinan; mantiene la altura', d_Stabilized: 'Los mandos inclinan; el empuje es suyo',
    blocked: 'No está listo: {why}', battery: 'Batería', link: 'Enlace', latency: 'Retardo', position: 'Posición', height: 'Altura', speed: 'Velocidad', heading: 'Rumbo',
    loc_0: 'apagada', loc_1: 'buscando', loc_2: 'segura', loc_3: 'perdida', localization: 'Lugar', fc: 'Controlador', rangers: 'Sensores', loop: 'Bucle', fit: 'ajuste {n} %', missed: '{n} perdidos', ok: 'bien', silent: 'en silencio', speaking: 'activos',
    video: 'Cámara', no_video: 'Sin cámara', no_video_why: 'Este dron se inició sin cámara (--camera). El plano muestra lo que ve con sus sensores de distancia.', video_connecting: 'Conectando con la cámara …', video_stale: 'La imagen es antigua', video_large: 'Imagen grande (V)', video_record: 'Grabar la imagen', no_recording: 'No hay imagen que grabar',
    goto: 'Volar aquí', goto_wall: 'Ahí no hay suelo libre', need_control: 'Tome primero el control', need_flight: 'Despegue primero', layers: 'Capas', fit_view: 'Todo el plano', follow: 'Seguir', zoom_in: 'Acercar', zoom_out: 'Alejar',
    l_cones: 'Sensores', l_particles: 'Partículas', l_histogram: 'Direcciones', l_path: 'Camino volado', l_names: 'Salas', l_fence: 'Valla',
    no_pad: 'Conecte un mando o una emisora y pulse un botón', pad: 'Mando', preset: 'Disposición', use_pad: 'Volar con mandos', pad_on: 'Mandos activos', throttle_first: 'Centre primero el mando de gas', pad_lost: 'Mando desconectado: mandos centrados', pad_frozen: 'Mando congelado: mandos centrados', unfocused: 'Los mandos descansan mientras la página no está delante',
    expo: 'Expo', dead_zone: 'Zona muerta', axis_x: 'Adelante', axis_y: 'Derecha', axis_z: 'Arriba', axis_r: 'Giro',
    edit: 'Editar', done: 'Listo', all_rooms: 'Visitar todas las salas', clear: 'Vaciar', upload: 'Enviar al dron', download: 'Leer del dron', start: 'Empezar', waypoint: 'Punto {n}', seconds: '{n} s', sent: 'La misión está a bordo', not_sent: 'La misión fue rechazada: {why}', mission_hint: 'Pulse en el plano para añadir puntos; arrastre para moverlos.', wait: 'Espera', remove: 'Quitar', then_home: 'Volver y aterrizar al final', mission_state: 'Punto {n} de {m}', empty: 'Aún no hay puntos',
    search: 'Buscar', changed: 'cambiado', value: 'Valor', default: 'por defecto {v}', loading: '{n} de {m}', refused_param: 'no aceptado',
    messages: 'Mensajes', logins: 'Accesos', intrusions: 'Intrusiones', actions: 'Acciones', time: 'Hora', what: 'Qué', from: 'Desde', nothing: 'Nada todavía', files: 'Archivos', save: 'Guardar',
    role: 'Rol', add_user: 'Añadir usuario', viewer_role: 'observador', new_password: 'Contraseña nueva (10 caracteres o más)', name: 'Nombre', sure_remove: '¿Quitar a {who}?',
    light: 'Claro', dark: 'Oscuro', language: 'Idioma', freeze: 'Congelar', c_height: 'Altura, m', c_speed: 'Velocidad, m/s', c_tilt: 'Inclinación, °', c_battery: 'Batería, V', c_sigma: 'Posición 1σ, m', c_link: 'Retardo, ms', c_roll: 'alabeo', c_pitch: 'cabeceo', c_x: 'x', c_y: 'y', c_z: 'arriba',
    v_1: 'Un mensaje estaba roto', v_2: 'Un mensaje llegó desordenado', v_3: 'Demasiado tarde: no se hizo', v_4: 'Otro tiene el control', v_5: 'Su rol no lo permite', v_6: 'Número de estación equivocado',
    avoid: 'Esquivar', avoid_why: 'Rodear obstáculos (VFH_ENABLE)', evade: 'Ceder paso', evade_why: 'Apartarse de las personas (AVOID_EVADE)', search_place: 'Buscar', search_place_why: 'Despegar y mirar alrededor si el lugar no se conoce (LOC_SEARCH)',
    live: 'En vivo', replay: 'Repetición', play: 'Reproducir', save_recording: 'Guardar esta grabación', open_recording: 'Abrir una grabación', not_a_recording: 'Esto no es una grabación de esta consola', replay_click: 'Esto es una repetición: vuelva a en vivo para volar',
    keys: 'Esc para · T despega · L aterriza · 0 todo el plano', failed: '{what}: {why}', ago: 'hace {n} s', percent: '{n} %',
    vehicles: 'Drones', open: 'Abrir', reachable: 'Disponible', not_yours: 'No asignado a usted', no_vehicles: 'No tiene ningún dron asignado: pídalo a un administrador.', no_vehicles_admin: 'Aún no hay drones: añada el primero.',
    add_vehicle: 'Añadir dron', vehicle_url: 'Dirección con su clave', vehicle_name: 'Nombre aquí (o el suyo propio)', vehicle_url_why: '«kestrel passwd --key NOMBRE» en el dron la muestra; también sirve el enlace de un simulador.', assigned_to: 'Asignado a', assign: 'Asignar a {who}', take_away: 'Quitar a {who}',
    look_again: 'Repetir', looking: 'El dron vuela el registro otra vez …',
  },
};

let language = TABLE[localStorage.getItem('language')] ? localStorage.getItem('language') : TABLE[navigator.language?.slice(0, 2)] ? navigator.language.slice(0, 2) : 'en';

/** A text by its key, with {holes} filled. */
export function t(key, holes = {}) {
  const text = TABLE[language][key] ?? TABLE.en[key] ?? key;
  return text.replace(/\{(\w+)\}/g, (_, name) => holes[name] ?? '');
}

export const languages = Object.keys(TABLE);
export const current = () => language;

export function speak(next) {
  localStorage.setItem('language', next);
  location.reload();
}

/** Keys that one language has and another has not: for the tests. */
export function missing() {
  const all = Object.keys(TABLE.en);
  return languages.flatMap((l) => [...all.filter((k) => !(k in TABLE[l])), ...Object.keys(TABLE[l]).filter((k) => !all.includes(k))].map((k) => `${l}:${k}`));
}
